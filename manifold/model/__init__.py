"""The fitted manifold: latents of a library's materials, predictions, colours, diagnostics, its file."""

from manifold.model.manifold import Embedded, LibraryChangedWarning, Manifold, Settings

__all__ = ["Embedded", "LibraryChangedWarning", "Manifold", "Settings"]
