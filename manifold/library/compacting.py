"""Compacts libraries: replaces each material by its compact form, after verifying the stored data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.colour import panel
from manifold.core import progress
from manifold.core.defaults import COMPACT_TOLERANCE
from manifold.core.errors import LibraryError
from manifold.core.judged_lights import BALL
from manifold.core.metrics import cube_root_error
from manifold.core.names import percent
from manifold.core.pairs import Pairs, RusinkiewiczGrid
from manifold.core.records import AnyArray, Array, BsdfFile
from manifold.core.stores import Entry
from manifold.library import staging, visible_normals
from manifold.library.compact import EXTRA, Compact, decode
from manifold.library.identity import (
    Accuracy,
    MaterialInfo,
    info_of,
    present_arrays,
    require_tolerance,
)
from manifold.library.layout import COEFFICIENTS, TABLES, read_attributes
from manifold.library.staging import write_material
from manifold.library.store import Library, read_material

CUBE_ROOT_PER_BALL = 0.05
"""Allowed cube-root error per allowed CIEDE2000 of the ball: 1 % at a tolerance of 0.2."""

_COARSEST = 0.08  # step, relative to the root mean square of the norms of spectra
_MOST_STEPS = 12
_LUMINANCE_WEIGHT = 0.5  # weight of the luminance, relative to all bands together
_VNDF_BITS, _BASIS_BITS = 10, 8  # last bits that are not kept


@dataclass(frozen=True)
class CompactResult:
    """The outcome for each material of a library.

    Attributes:
        compacted: errors of the materials that were compacted, by name.
        skipped: names of materials that were compact already.
        failed: reasons of failures by name; these materials stay as they were.
    """

    compacted: dict[str, Accuracy]
    skipped: tuple[str, ...]
    failed: dict[str, str]


def compact_library(path: Path | str, tolerance: float = COMPACT_TOLERANCE) -> CompactResult:
    """Replace the materials of a library by their compact form, one after the other; the originals are lost.

    If the run is killed, every material is still whole, in one of the two forms; run it again to compact the rest.
    """
    require_tolerance(tolerance)
    library = Library(path)
    home = library.folder
    result = CompactResult({}, (), {})
    skipped = []
    with staging.writing(home) as staged:
        for name in progress.each(library.names, str):
            folder = home / "materials" / name
            try:
                for part in (folder, *folder.iterdir()):
                    staging.require_no_link(part)
                info = library.attributes(name)
                if info.accuracy is None:
                    result.compacted[name] = _compact(library, info, staged / name, folder, tolerance)
                else:
                    library.read(name)  # `accuracy` is no proof that the compact form is there
                    staging.keep_arrays(folder, (COEFFICIENTS, TABLES))
                    skipped.append(name)
            except LibraryError as error:
                result.failed[name] = str(error)
        staging.consolidate(home)
    return replace(result, skipped=tuple(skipped))


def _compact(library: Library, info: MaterialInfo, staged: Path, folder: Path, tolerance: float) -> Accuracy:
    file = library.read(info.name)
    compact = encode(file, tolerance)
    write_material(staged, file, info.source_file, info.sha256, compact)
    written = Entry.of_folder(staged)
    expected = info_of(info.name, read_attributes(written))
    _, found = read_material(written, expected, is_rgb=library.bands.is_rgb)
    if found != expected.content_sha256:
        raise LibraryError(
            f"{info.name}: differs from what should have been written; check the disk, and try again"
        )
    staging.supplant(staged, folder)
    return compact.accuracy


def encode(file: BsdfFile, tolerance: float = COMPACT_TOLERANCE) -> Compact:
    """Return the coarsest compact form whose decoded file stays within a tolerance.

    The tolerance bounds the mean CIEDE2000 over a rendered ball; the cube-root error may reach `CUBE_ROOT_PER_BALL`
    times the tolerance.
    """
    roots, errors_of, kept = _Roots(file), _errors_from(file), _kept_tables(file)
    step, most = _COARSEST * roots.norm, Accuracy(tolerance, tolerance, CUBE_ROOT_PER_BALL * tolerance)
    for _ in range(_MOST_STEPS):
        coefficients, basis = roots.quantised(step)
        tables = kept | {"step": np.array([step]), "basis": basis}
        ball, cube_root = errors_of(replace(file, **decode(coefficients, tables)))
        excess = max(ball / most.ball, cube_root / most.cube_root)
        if excess <= 1.0:
            return Compact(coefficients, tables, Accuracy(tolerance, ball, cube_root))
        step *= min(max(0.8 / excess, 0.25), 0.8)
    raise LibraryError(
        f"{file.name}: its compact form differs by {ball:.3g} {BALL} and {percent(cube_root, 2)} in cube roots at the "
        f"finest step, expected at most {most.ball:.3g} and {percent(most.cube_root, 2)}; raise the tolerance, "
        "or keep the material uncompressed"
    )


class _Roots:
    """A file's cube roots, luminance included, in components fitted to them; `norm` is the RMS of the spectral ones."""

    def __init__(self, file: BsdfFile) -> None:
        values = np.moveaxis(file.spectra, 2, -1)
        self._shape, count = values.shape[:-1], values.shape[-1]
        self._is_lit = np.any(values != 0, axis=-1).reshape(-1)
        self._least = 0.0 if file.spectra.min() >= 0.0 else -np.inf
        self._weight = _LUMINANCE_WEIGHT * np.sqrt(count)
        luminance = self._weight * np.cbrt(np.maximum(file.luminance, 0.0)).reshape(-1, 1)
        roots = np.hstack([np.cbrt(values.reshape(-1, count)), luminance.astype(np.float32)])
        roots[~self._is_lit] = 0.0
        products = (roots.T @ roots).astype(np.float64)
        components = np.linalg.eigh(products)[1].T[::-1].astype(np.float32)
        components[0] *= np.where(components[0].sum() < 0.0, -1.0, 1.0)  # positive where all values are
        self._components = components
        self._coefficients = components @ roots.T  # [B + 1, n]
        self.norm = float(np.sqrt(np.trace(products) / max(np.count_nonzero(self._is_lit), 1))) or 1.0

    def quantised(self, step: float) -> tuple[NDArray[np.int32], Array]:
        """Return the coefficients as they are stored, and the basis."""
        multiples = np.rint(self._coefficients / np.float32(step)).astype(np.int32)
        count = 1 + int(np.flatnonzero(np.any(multiples, axis=1)).max(initial=0))
        multiples, basis = multiples[:count], self._components[:count].copy()
        basis[:, -1] /= self._weight
        # Cells that hold something keep something: empty ones would pass for unmeasured.
        decoded = np.maximum(multiples.T.astype(np.float32) @ basis[:, :-1], self._least)
        empty = self._is_lit & ~np.any(decoded, axis=1)
        multiples[:, empty] = 0
        multiples[0, empty] = 1
        multiples = multiples.reshape(count, *self._shape)
        differences = np.diff(np.diff(multiples, axis=-1, prepend=0), axis=-2, prepend=0)
        return differences, _rounded(basis.view(np.int32), _BASIS_BITS).view(np.float32)


def _rounded(numbers: NDArray[np.int32], bits: int) -> NDArray[np.int32]:
    """Round int32 numbers, or the bit patterns of float32, so that their last bits are zero."""
    return (numbers + (1 << (bits - 1))) >> bits << bits


def _kept_tables(file: BsdfFile) -> dict[str, AnyArray]:
    difference, slices = visible_normals.encode(file)
    fields = {
        name: a for name, a in present_arrays(file).items() if name not in ("vndf", "luminance", "spectra")
    }
    return {
        **fields,
        **{f"{EXTRA}{name}": array for name, array in file.extra.items()},
        **slices._asdict(),
        # Zeros, and what is next to them, are kept.
        "vndf_difference": np.where(
            file.vndf.view(np.int32) < 1 << _VNDF_BITS, difference, _rounded(difference, _VNDF_BITS)
        ),
        "is_nonnegative": np.array([file.spectra.min() >= 0.0], np.uint8),
    }


@cache
def _pairs(is_isotropic: bool) -> Pairs:
    return RusinkiewiczGrid.named("default").suited_to(is_isotropic).pairs()


def _errors_from(file: BsdfFile) -> Callable[[BsdfFile], tuple[float, float]]:
    """Return a function that returns the ball and cube-root errors of another form of a file."""
    lights, pairs = panel.judged(), _pairs(file.is_isotropic)

    def values(other: BsdfFile) -> tuple[Array, Array]:
        brdf = MeasuredBRDF(other)
        return lights.xyz(values_at(brdf, lights), brdf.bands), values_at(brdf, pairs)

    xyz, f = values(file)

    def errors(other: BsdfFile) -> tuple[float, float]:
        xyz_star, f_star = values(other)
        return lights.compare(xyz, xyz_star).ball, cube_root_error(f, f_star, pairs.cosines)

    return errors
