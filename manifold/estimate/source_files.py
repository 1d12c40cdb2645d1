"""Provides files of the materials that a user names, including predictions.

The modules for predictions are imported at first use, which takes 1.5 s.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from manifold.core.records import BsdfFile
from manifold.estimate.sources import FileSource, MaterialSource, PlaceSource, read_measured
from manifold.formats.tensor_file import is_compressed
from manifold.io_rgl import read_bsdf, write_bsdf


def read_source(source: MaterialSource) -> BsdfFile:
    """Return the RGL file of a source, in the orientation in which it was measured.

    A prediction is measured by the virtual goniometer.
    """
    if not isinstance(source, PlaceSource):
        return read_measured(source)
    with source_file(source) as path:
        return read_bsdf(path)


@contextmanager
def source_file(source: MaterialSource) -> Iterator[Path]:
    """Yield the path of a file that holds a source and that Mitsuba opens.

    The file is temporary unless the source is itself such a file.
    """
    if isinstance(source, FileSource) and not is_compressed(source.path):
        yield source.path
        return
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{source.name}.bsdf"
        if not isinstance(source, PlaceSource):
            write_bsdf(path, read_measured(source))
        else:
            from manifold.estimate.predictions import predict
            from manifold.model.output_file import FINE_OPTIONS

            predict(
                source.model, source.place, path, library=source.library, colour=source.colour, options=FINE_OPTIONS,
            )  # fmt: skip
        yield path
