"""Chooses the mapping and the number of dimensions of a manifold by the errors of left-out materials.

The materials are divided into folds. For every fold, a candidate is fitted without it, locates the fold's materials
from their data, and predicts them; the errors of these predictions are compared. With up to twenty materials every
fold holds one (leave-one-out).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.core import progress
from manifold.core.errors import UsageError
from manifold.core.names import counted
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import evenly_spaced
from manifold.evaluate.coherences import measure_map
from manifold.evaluate.cross_validation import cross_validate, leave_out, wall_clock
from manifold.evaluate.errors import MethodErrors, measure_errors
from manifold.evaluate.latent_models import fit_map, fit_settings
from manifold.evaluate.method_data import Data
from manifold.model.materials import MaterialTable
from manifold.model.settings import COMPARED_BANDS, SAMPLE_BANDS, BlendSettings, GplvmSettings, Settings
from manifold.registries import MAPPINGS

GRID = RusinkiewiczGrid(24, 12, 8)  # a fifth of the pairs of the default grid
MAX_DIMENSIONS = 6
PAYS = 0.05  # an added dimension has to take this share off error times detour
LEAVE_ONE_OUT_UP_TO = 20  # materials; more are dealt into FOLDS
FOLDS = 5
_TOLERANCE = 1e-4  # tolerance of fits: finer ones move no error by more than it varies between folds


@dataclass(frozen=True, kw_only=True)
class Candidate(MethodErrors):
    """One setting and its errors for left-out materials.

    Attributes: those of `MethodErrors`, and
        mapping, latent_dim: the setting.
        error: geometric mean of the linear error over the materials, by which mappings are chosen.
        detour: geometric mean of the detours on a map of all materials, see `model.coherence`; 1 without any.
        seconds: time of fitting and encoding all folds.
        is_chosen: whether this candidate was chosen.
    """

    mapping: str
    latent_dim: int
    error: float
    detour: float
    seconds: float
    is_chosen: bool = False

    @property
    def score(self) -> float:
        """Error times detour, by which the number of dimensions is chosen."""
        return self.error * self.detour


def choose(
    materials: Sequence[MeasuredBRDF],
    settings: Settings,
    *,
    mapping: bool,
    latent_dim: bool,
) -> tuple[Settings, list[Candidate]]:
    """Choose a mapping at the settings' number of dimensions, then the number of dimensions under that mapping.

    There must be at least four materials with the same bands. Returns the chosen settings, and all candidates that
    were tried, in order.
    """
    if len(materials) < 4:
        raise UsageError(
            f"found {counted(len(materials), 'material')}, expected at least 4 to choose settings by left-out errors; "
            "choose mapping and dimensions yourself, or import more"
        )
    trials = _Trials(materials, settings)
    most = min(MAX_DIMENSIONS, len(materials) - 2)
    tried: dict[tuple[str, int], Candidate] = {}
    mappings = list(MAPPINGS) if mapping and isinstance(settings, GplvmSettings) else [settings.mapping]
    total = len(mappings) * mapping + most * latent_dim

    def attempt(name: str, count: int) -> Candidate:
        if (name, count) not in tried:
            with progress.listen(None):
                tried[name, count] = trials.run(name, count)
            progress.report(len(tried), max(total, len(tried)), tried[name, count].title)
        return tried[name, count]

    start = min(settings.latent_dim, most)
    best = min((attempt(name, start) for name in mappings), key=lambda c: c.error)
    if latent_dim:
        best = attempt(best.mapping, 1)
        for count in range(2, most + 1):
            more = attempt(best.mapping, count)
            if more.score < (1.0 - PAYS) * best.score:
                best = more
            elif count > best.latent_dim + 1:
                break  # two in a row that did not pay
    chosen = _candidate(settings, best.mapping, best.latent_dim)
    return chosen, [replace(c, is_chosen=c is best) for c in tried.values()]


def _candidate(settings: Settings, mapping: str, latent_dim: int) -> Settings:
    """Return settings with another number of dimensions and, of a GPLVM, another mapping."""
    if isinstance(settings, GplvmSettings):
        return replace(settings, mapping=mapping, latent_dim=latent_dim)
    return replace(settings, latent_dim=latent_dim)


class _Trials:
    """Values of all materials, and their errors when left out, under any setting."""

    def __init__(self, materials: Sequence[MeasuredBRDF], settings: Settings) -> None:
        n_bands, N = materials[0].bands.count, len(materials)
        sample_bands = settings.sample_bands if isinstance(settings, BlendSettings) else SAMPLE_BANDS
        bands = np.union1d(evenly_spaced(n_bands, COMPARED_BANDS), evenly_spaced(n_bands, sample_bands))
        self._settings = settings
        self._data = Data.evaluate(materials, GRID, bands, stride=1)
        self._table = MaterialTable(materials, bands)
        self._splits = leave_out(N, N if N <= LEAVE_ONE_OUT_UP_TO else FOLDS)

    def run(self, name: str, latent_dim: int) -> Candidate:
        """Return the errors of left-out materials with one setting."""
        settings = _candidate(self._settings, name, latent_dim)
        fit = fit_settings(settings, tolerance=_TOLERANCE)
        encoded, seconds = wall_clock(lambda: cross_validate(self._data, fit, self._splits))
        found = encoded.combinations
        (errors,) = measure_errors([found], self._data.bands, [self._data])
        of_each = self._table.looks(found) | errors.of_values()
        mean = float(np.exp(np.mean(np.log(np.maximum(of_each.linear, 1e-12)))))
        _, pairs = measure_map(*fit_map(settings, self._data), self._table)
        detour = float(np.exp(np.mean([np.log(pair.detour) for pair in pairs]))) if pairs else 1.0
        return Candidate(
            key=f"{name}_{latent_dim}", title=f"{name}, {latent_dim} dimensions", errors=of_each, mapping=name,
            latent_dim=latent_dim, error=mean, detour=detour, seconds=seconds,
        )  # fmt: skip
