"""What the operating system leaves to do: files that appear whole, temporary folders, bounded reads, threads."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
