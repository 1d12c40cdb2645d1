"""Embedding of measured files that are not in the library."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from manifold import __version__
from manifold.model import diagnostics
from manifold.model.checked_file import require_bsdf_output
from manifold.model.manifold import Manifold
from manifold.model.reconstructed import Reconstruction, judge, read_filled
from manifold.records import Progress


@dataclass(frozen=True)
class Located:
    """Where a file belongs on a manifold.

    Attributes:
        path: the file.
        latent: shape (Q,).
        coordinates: the same, with the digits that reproduce the prediction there.
        colours: colour coordinate of every band (B,), of a blend also its gain (2, B); None where latents fix them.
        expected_ball: expected CIEDE2000 of the ball there; None where the model is not calibrated.
        expected_cube_root: expected cube-root error.
        materials: number of materials of the model, on whose left-out errors expected ones are based.
        nearest: the three nearest materials with their distances.
        reconstruction: errors of the prediction there, in these colours, and where it was written.
    """

    path: Path
    latent: tuple[float, ...]
    coordinates: tuple[str, ...]
    colours: list[Any] | None
    expected_ball: float | None
    expected_cube_root: float | None
    materials: int
    nearest: tuple[tuple[str, float], ...]
    reconstruction: Reconstruction

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the program's version."""
        content = {"program": f"manifold {__version__}"} | vars(self) | {"path": str(self.path)}
        del content["reconstruction"]
        return content | self.reconstruction.to_json()


def locate(
    model: Manifold | Path | str,
    path: Path | str,
    output: Path | str | None = None,
    *,
    library: Path | str | None = None,
    physical: bool = False,
    force: bool = False,
    on_progress: Progress | None = None,
) -> Located:
    """Embed a measured file, with its unmeasured cells filled, in a fitted manifold.

    Args:
        model: a fitted manifold, or the path of one.
        path: the measured file.
        output: a `.bsdf` file for the prediction at the latent, in the colours found; None writes none.
        library: where the model's library is now, if not where the model remembers it.
        physical, force: of the output, see `judge`.
        on_progress: called with (done, total, what) while materials are read.
    Raises:
        FileFormatError: it is no RGL file.
        BandMismatchError: its bands are not the library's.
        UsageError: the output cannot be written, or its albedo would exceed 1.05.
    """
    path, output = Path(path), None if output is None else Path(output)
    if output is not None:
        require_bsdf_output(output, "reconstructions")
    brdf, notes = read_filled(path)
    loaded = model if isinstance(model, Manifold) else Manifold.load(model, library)
    loaded.prepare(on_progress)
    found = loaded.embed(brdf)
    coordinates = loaded.space.printed(found.latent)
    predicted = loaded.predict(found.latent, found.colours)
    expected = loaded.expected_error(found.latent, found.colours)
    how = f"at latent ({', '.join(coordinates)})"
    made = judge(brdf, predicted, output, how, physical=physical, force=force)
    sentences = diagnostics.of_embedding(made.relative_error, made.ball) + notes + made.diagnostics
    return Located(
        path=path,
        latent=tuple(float(v) for v in found.latent),
        coordinates=coordinates,
        colours=None if found.colours is None else found.colours.tolist(),
        expected_ball=None if expected is None else float(expected.ball),
        expected_cube_root=None if expected is None else float(expected.cube_root),
        materials=len(loaded.names),
        nearest=tuple(loaded.nearest(found.latent, 3)),
        reconstruction=replace(made, diagnostics=sentences + loaded.notes),
    )
