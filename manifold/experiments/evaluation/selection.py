"""Mapping and number of dimensions by held-out error: as many as pay for themselves.

The materials are dealt into folds. Every candidate is fitted without a fold, embeds its materials from their data,
and is judged by what it decodes; up to twenty materials every fold holds one, which is leave-one-out.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.errors import UsageError
from manifold.gplvm import GPLVM
from manifold.mapping import MAPPINGS, mapping_named
from manifold.metrics import RusinkiewiczGrid, cosine_weight
from manifold.model.manifold import Settings
from manifold.models.encoding import Decoder
from manifold.models.per_band import MonochromeGPLVM
from manifold.parallel import one_blas_thread
from manifold.records import Array, Progress, evenly_spaced

GRID = RusinkiewiczGrid(24, 12, 8)  # a fifth of the pairs of the default grid
MAX_BANDS = 12  # of a whole material
MAX_DIMENSIONS = 6
PAYS = 0.05  # an added dimension has to take this share off the error
LEAVE_ONE_OUT_UP_TO = 20  # materials; more are dealt into FOLDS
FOLDS = 5
_TOLERANCE = 1e-4  # of the fits: finer ones move no error by more than it varies between folds


@dataclass(frozen=True)
class Candidate:
    """One setting and how it predicts materials it has not seen.

    Attributes:
        mapping, latent_dim: the setting.
        error: geometric mean over materials of the relative error, which the choice is made by.
        median, p90: of the relative error.
        seconds: for all folds.
        is_chosen: whether it won.
    """

    mapping: str
    latent_dim: int
    error: float
    median: float
    p90: float
    seconds: float
    is_chosen: bool = False


def choose(
    materials: Sequence[MeasuredBRDF],
    settings: Settings,
    *,
    mapping: bool,
    latent_dim: bool,
    on_progress: Progress | None = None,
) -> tuple[Settings, list[Candidate]]:
    """Choose a mapping at the given number of dimensions, then the number of dimensions under that mapping.

    Args:
        materials: at least four, of the same bands.
        settings: what is not chosen; its `latent_dim` is where the choice of a mapping is made.
        mapping, latent_dim: what to choose.
        on_progress: called with (done, total, what); the total is an upper bound.
    Returns:
        The settings chosen, and all candidates that were tried, in order.
    Raises:
        UsageError: there are fewer than four materials.
    """
    if len(materials) < 4:
        raise UsageError(
            f"found {len(materials)} materials, expected at least 4 to choose by held-out error; "
            "give --mapping and --latent-dim, or import more"
        )
    trials = _Trials(materials, settings)
    most = min(MAX_DIMENSIONS, len(materials) - 2)
    tried: list[Candidate] = []
    total = len(MAPPINGS) * mapping + most * latent_dim

    def attempt(name: str, count: int) -> Candidate:
        for known in tried:
            if (known.mapping, known.latent_dim) == (name, count):
                return known
        tried.append(trials.run(name, count))
        if on_progress is not None:
            on_progress(len(tried), max(total, len(tried)), f"{name}, {count} dimensions")
        return tried[-1]

    best = attempt(settings.mapping if not mapping else next(iter(MAPPINGS)), min(settings.latent_dim, most))
    if mapping:
        best = min((attempt(name, best.latent_dim) for name in MAPPINGS), key=lambda c: c.error)
    if latent_dim:
        best = attempt(best.mapping, 1)
        for count in range(2, most + 1):
            more = attempt(best.mapping, count)
            if more.error < (1.0 - PAYS) * best.error:
                best = more
            elif count > best.latent_dim + 1:
                break  # two in a row that did not pay
    chosen = replace(settings, mapping=best.mapping, latent_dim=best.latent_dim)
    return chosen, [replace(c, is_chosen=c is best) for c in tried]


class _Trials:
    """Values of all materials, and their held-out errors under any setting."""

    def __init__(self, materials: Sequence[MeasuredBRDF], settings: Settings) -> None:
        self._settings = settings
        self._is_curves = settings.kind == "monochrome"
        count = settings.sample_bands if self._is_curves else MAX_BANDS
        bands = evenly_spaced(materials[0].bands.count, count).tolist()
        wi, wo, above = GRID.directions()
        wi, wo = wi[above], wo[above]
        self._cosines = cosine_weight(wi, wo)
        self._f = np.stack([m.select_bands(bands).eval(wi, wo).T for m in materials])  # [N, B, P]
        folds = len(materials) if len(materials) <= LEAVE_ONE_OUT_UP_TO else FOLDS
        self._folds = [np.arange(k, len(materials), folds) for k in range(folds)]

    def run(self, name: str, latent_dim: int) -> Candidate:
        """Held-out errors of one setting."""
        start = time.perf_counter()
        mapping = mapping_named(name)
        T = mapping.forward(np.swapaxes(self._f, 1, 2), np.broadcast_to(self._cosines, self._f.shape[::2]))
        T = np.ascontiguousarray(np.swapaxes(T, 1, 2))  # [N, B, P]
        error = np.empty(len(self._f))
        for fold in self._folds:
            others = np.setdiff1d(np.arange(len(self._f)), fold)
            with one_blas_thread:  # the matrices are small: a second thread costs more than it does
                decoder = self._fit(T[others], name, latent_dim)
                for i in fold:
                    f = self._f[i] if self._is_curves else self._f[i].reshape(1, -1)
                    error[i] = decoder.relative_error(decoder.encode(f), f)
        return Candidate(
            mapping=name,
            latent_dim=latent_dim,
            error=float(np.exp(np.mean(np.log(np.maximum(error, 1e-12))))),
            median=float(np.median(error)),
            p90=float(np.percentile(error, 90)),
            seconds=time.perf_counter() - start,
        )

    def _fit(self, T: Array, name: str, latent_dim: int) -> Decoder:
        """A model of mapped values T (N, B, P), as something that decodes its latents."""
        s, (N, B, P) = self._settings, T.shape
        if self._is_curves:
            samples = T.reshape(N * B, P)
            curves = MonochromeGPLVM(
                latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior
            )
            gp = curves.fit_gram((samples * self._cosines) @ samples.T, N, P).gp_
            weight, group = self._cosines, B
        else:
            samples, weight, group = T.reshape(N, B * P), np.tile(self._cosines, B), 1
            whole = GPLVM(
                latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, optimizer=s.optimizer, prior=s.prior,
                tol=_TOLERANCE,
            )  # fmt: skip
            gp = whole.fit_gram((samples * weight) @ samples.T, B * P).gp_
        return Decoder(gp, latent_dim, group, samples, mapping_named(name), weight, weight, s.prior)
