"""Failure modes of storage: libraries that were changed after a model was fitted to them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from manifold.evaluate.stability.data_failures import middle_of_family
from manifold.evaluate.stability.testbed import ALPHAS, TestBed, named
from manifold.evaluate.stability.trials import SAME_RESULT, Measurement, Mode
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.metrics import relative_error
from manifold.model.manifold import Manifold
from manifold.records import Array

_FIRST, _SECOND = named(ALPHAS[1], 1), named(ALPHAS[2], 1)

Change = Callable[[Path, float], None]
"""Done to a folder of `library.zarr` and `model.h5` by a severity; 0 does nothing."""


def _predicted(change: Change, bed: TestBed, severity: float) -> Measurement:
    """A prediction half way between two materials after a change of the library, beside that before."""

    def make() -> Path:
        model = bed.fit(middle_of_family(bed), "material")
        model.save(model.library.path.parent / "model.h5")
        return model.library.path.parent

    def values(folder: Path) -> Array:
        model = Manifold.load(folder / "model.h5")
        return model.predict(model.between(_FIRST, _SECOND, 0.5)).eval(bed.pairs.wi, bed.pairs.wo)

    with TemporaryDirectory() as temporary:
        folder = Path(shutil.copytree(bed.cached("storage", make), temporary, dirs_exist_ok=True))
        whole = values(folder)
        change(folder, severity)
        return Measurement(relative_error(whole, values(folder)))


def _exchange(folder: Path, count: float) -> None:
    """Exchange materials of the library for others under the same names."""
    library = Library.open(folder / "library.zarr")
    (folder / "new").mkdir()
    for name in _materials(library)[: int(count)]:
        file = library.read(name)
        write_bsdf(
            folder / "new" / f"{name}_spec.bsdf", replace(file, spectra=file.spectra * np.float32(0.5))
        )
    if count:
        import_files(library.path, [folder / "new"], replace=True)


def _remove(folder: Path, count: float) -> None:
    """Remove materials from the library."""
    library = Library.open(folder / "library.zarr")
    for name in _materials(library)[: int(count)]:
        shutil.rmtree(library.path / "materials" / name)


def _materials(library: Library) -> list[str]:
    """Names of the materials, those that predictions are between first."""
    return [_FIRST, _SECOND, *(name for name in library.names if name not in (_FIRST, _SECOND))]


MODES: tuple[Mode, ...] = (
    Mode(
        "changed_library", "materials of a library exchanged, or removed, after a model was fitted to it",
        "materials", (0.0, 1.0, 3.0), SAME_RESULT,
        {"exchanged": partial(_predicted, _exchange), "removed": partial(_predicted, _remove)},
        "Embed again after every change of a library.",
    ),
)  # fmt: skip
