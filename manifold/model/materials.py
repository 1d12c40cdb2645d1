"""Reads the measured materials of a manifold from its library at first use, in all or a few bands."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from manifold.brdf.interface import all_isotropic
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.orientation import rotation_of
from manifold.brdf.unmeasured_cells import fill_unmeasured, unmeasured_cells, unmeasured_share
from manifold.colour import panel
from manifold.core import progress
from manifold.core.errors import UnknownNameError
from manifold.core.metrics import Errors
from manifold.core.names import names_like
from manifold.core.records import Array, BsdfFile, Indices
from manifold.gp.encoding import encoding_pairs
from manifold.library.store import Library
from manifold.model.combination import Combination, Values, evaluate

_MOST_KEPT = 1000  # materials in memory, those read last
_AT_ONCE = 16  # materials read together where none are kept


class _Latest(dict[str, MeasuredBRDF]):
    """The materials that were put in last."""

    def __setitem__(self, name: str, material: MeasuredBRDF) -> None:
        super().__setitem__(name, material)
        while len(self) > _MOST_KEPT:
            self.pop(next(iter(self)), None)


class MaterialCache:
    """Materials of a library by name, in the order of the latents.

    They are available as measured, with unmeasured cells filled, and in a few bands only.

    Attributes:
        is_nonnegative: whether negative values are treated as 0 when materials are combined; RGB files have negative
            values for colours outside sRGB.
        fills_cells: whether unmeasured cells are filled; otherwise they stay zero.
    """

    def __init__(
        self,
        library: Library,
        names: Sequence[str],
        *,
        is_nonnegative: bool = False,
        fills_cells: bool = True,
    ) -> None:
        self.library, self.names, self.is_nonnegative = library, tuple(names), is_nonnegative
        self.fills_cells = fills_cells
        self._measured: dict[str, MeasuredBRDF] = _Latest()
        self._filled: dict[str, MeasuredBRDF] = _Latest()
        self._in_bands: tuple[tuple[int, ...], dict[str, MeasuredBRDF]] = (), _Latest()
        self._unmeasured_shares: dict[str, float] = {}
        self._cut: set[str] = set()  # names of materials of which negative values were taken for 0
        self._turned: dict[str, float] = {}  # azimuths by which those with a direction lie turned

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels to other processes, which read the materials from the library."""
        return vars(self) | {"_measured": _Latest(), "_filled": _Latest(), "_in_bands": ((), _Latest())}

    def __repr__(self) -> str:
        return f"<MaterialCache: {len(self.names)} materials of {self.library.path.name}>"

    @cached_property
    def is_isotropic(self) -> bool:
        """Return whether all materials are isotropic; anisotropic materials need direction pairs of all azimuths."""
        return all(self.library.attributes(name).is_isotropic for name in self.names)

    @cached_property
    def is_synthetic(self) -> bool:
        """Return whether any material is synthetic."""
        return any(self.library.attributes(name).is_synthetic for name in self.names)

    def index(self, name: str) -> int:
        """Return the index of a material."""
        if name not in self.names:
            raise UnknownNameError(f"no material '{name}' in this model; {names_like(self.names, name)}")
        return self.names.index(name)

    def measured(self, name: str) -> MeasuredBRDF:
        """Return a material with its unmeasured cells filled; negative values are kept."""
        self.index(name)
        if name not in self._measured:
            is_same = name in self._filled and name not in self._cut
            self._measured[name] = self._filled[name] if is_same else MeasuredBRDF(self.measured_file(name))
        return self._measured[name]

    def filled(self, names: Iterable[str] | None = None) -> list[MeasuredBRDF]:
        """Return materials, by default all, with their unmeasured cells filled, as predictions combine them."""
        return self._read(self._fill, self.names if names is None else tuple(names))

    def with_negative_values(self, names: Sequence[str] | None = None) -> list[MeasuredBRDF]:
        """Return materials, by default all, as references for errors: with filled cells, and negative values kept."""
        names = self.names if names is None else names
        filled = self.filled(names)
        return [
            MeasuredBRDF(self.measured_file(name)) if name in self._cut else material
            for name, material in zip(names, filled, strict=True)
        ]

    def in_bands(self, bands: Sequence[int], names: Iterable[str] | None = None) -> list[MeasuredBRDF]:
        """Return materials, by default all, in some of their bands, with unmeasured cells filled.

        Only these are cached.
        """
        key = tuple(int(b) for b in bands)
        if self._in_bands[0] != key:
            self._in_bands = key, _Latest()
        kept = self._in_bands[1]

        def read(name: str) -> MeasuredBRDF:
            found = kept.get(name)
            if found is None:
                known = self._filled.get(name)
                whole = MeasuredBRDF(self.filled_file(name)) if known is None else known
                found = kept[name] = whole.select_bands(list(key))
            return found

        return self._read(read, self.names if names is None else tuple(names))

    def stream(self) -> Iterator[MeasuredBRDF]:
        """Yield all materials with their unmeasured cells filled, one after another, without caching."""
        for first in range(0, len(self.names), _AT_ONCE):
            some = self.names[first : first + _AT_ONCE]
            with progress.listen(None):
                read = self._read(lambda name: MeasuredBRDF(self.filled_file(name)), some)
            yield from read
            progress.report(first + len(some), len(self.names), some[-1])

    def measured_file(self, name: str) -> BsdfFile:
        """Return a material's file with its unmeasured cells filled."""
        file = self.library.read(name)
        cells = unmeasured_cells(file)
        self._unmeasured_shares[name] = unmeasured_share(file, cells)
        if (rotation := rotation_of(file)) is not None:
            self._turned[name] = rotation - file.rotation_rad
        return fill_unmeasured(file, cells, copy=False) if self.fills_cells else file

    def filled_file(self, name: str) -> BsdfFile:
        """Return `measured_file`, for blends with negative values set to 0."""
        file = self.measured_file(name)
        if self.is_nonnegative and file.spectra.min() < 0:
            self._cut.add(name)
            return replace(file, spectra=np.maximum(file.spectra, 0))
        return file

    def unmeasured_share(self, name: str) -> float:
        """Return the share of a file's cells above the horizon that were not measured."""
        if name not in self._unmeasured_shares:
            self.measured_file(name)
        return self._unmeasured_shares[name]

    @property
    def farthest_turned(self) -> tuple[str, str, float]:
        """Return the two loaded materials with the largest angle between their orientations, and the angle in radians.

        The angle is at most a quarter of a turn; it is 0 if fewer than two materials have an orientation.
        """
        apart = [
            (a, b, abs((self._turned[a] - self._turned[b] + 0.5 * np.pi) % np.pi - 0.5 * np.pi))
            for a, b in itertools.combinations(sorted(self._turned), 2)
        ]
        return max(apart, key=lambda found: found[2], default=("", "", 0.0))

    def _fill(self, name: str) -> MeasuredBRDF:
        found = self._filled.get(name)
        if found is None:
            found = self._filled[name] = MeasuredBRDF(self.filled_file(name))
        return found

    def _read(
        self,
        read: Callable[[str], MeasuredBRDF],
        names: Sequence[str],
    ) -> list[MeasuredBRDF]:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            loaded = []
            for done, material in enumerate(pool.map(read, names), start=1):
                loaded.append(material)
                progress.report(done, len(names), material.name)
        return loaded


def names_among(library: Library, names: Collection[str]) -> tuple[str, ...]:
    """Return the named materials of a library, in its order. Raises UsageError for an unknown name."""
    names = {names} if isinstance(names, str) else names
    unknown = sorted(set(names) - set(library.names))
    if unknown:
        near = names_like(library.names, unknown[0])
        raise UnknownNameError(f"no material '{unknown[0]}' in {library.path.name}; {near}")
    return tuple(name for name in library.names if name in names)


def names_without(library: Library, names: Collection[str]) -> tuple[str, ...]:
    """Return all materials of a library except the named ones, in its order. Raises UsageError for an unknown name."""
    left_out = names_among(library, names)
    return tuple(name for name in library.names if name not in left_out)


_PREDICTED_AT_ONCE = 8  # predictions evaluated together


class MaterialTable:
    """Materials in some increasing bands (B,), for measuring the errors of their predictions."""

    def __init__(self, materials: Sequence[MeasuredBRDF], bands: Indices) -> None:
        """Select the bands of all materials."""
        self.bands = bands
        self.materials = [material.select_bands(bands.tolist()) for material in materials]
        self.lights, self._pairs = panel.judged(), encoding_pairs(all_isotropic(materials))

    @cached_property
    def on_ball(self) -> Values:
        """Return the values at the direction pairs of a rendered ball."""
        return Values.at(self.materials, self.lights)

    @cached_property
    def balls(self) -> list[Array]:
        """Return the CIE XYZ values (K, 3) of every material's ball in the five test lights."""
        return [self.lights.xyz(f, self.materials[0].bands) for f in self.on_ball.f]

    def ball(self, combination: Combination) -> Array:
        """Return the CIE XYZ values (K, 3) of a prediction's ball in the five test lights."""
        (f,) = evaluate([combination.in_bands(self.bands)], self.on_ball)
        return self.lights.xyz(f, self.materials[0].bands)

    @cached_property
    def _in_grid(self) -> Values:
        return Values.at(self.materials, self._pairs)

    def look(self, i: int, f: Array) -> Errors[float]:
        """Return the differences between the balls of material i and of values f (P, B) in 1/sr."""
        return self.lights.compare(self.balls[i], self.lights.xyz(f, self.materials[0].bands))

    def looks(self, combinations: Sequence[Combination]) -> Errors[Array]:
        """Return the differences between the balls of all materials and of one prediction for each."""
        here = [c.in_bands(self.bands) for c in combinations]
        found: list[Errors[float]] = []
        for first in range(0, len(here), _PREDICTED_AT_ONCE):
            predicted = evaluate(here[first : first + _PREDICTED_AT_ONCE], self.on_ball)
            found += [self.look(first + k, f) for k, f in enumerate(predicted)]
        return Errors.of_several(found)

    def errors(self, i: int, combination: Combination) -> Errors[float]:
        """Return the errors of a prediction of material i."""
        here = combination.in_bands(self.bands)
        on_ball, in_grid = (evaluate([here], values)[0] for values in (self.on_ball, self._in_grid))
        return self.look(i, on_ball) | Errors.of_values(self._in_grid.f[i], in_grid, self._pairs.cosines)
