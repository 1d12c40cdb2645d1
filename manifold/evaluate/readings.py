"""Measures the errors of left-out materials against the number of readings from which they are completed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import qr

from manifold import __version__
from manifold.colour import panel
from manifold.core import progress
from manifold.core.errors import UsageError
from manifold.core.metrics import Errors
from manifold.core.pairs import cosine_weight
from manifold.core.records import Array, Indices, plain
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.estimate.evidence import Evidence
from manifold.estimate.expected import calibrate, errors_of
from manifold.estimate.residual import coordinates
from manifold.estimate.suggestions import all_directions, readings_to_take
from manifold.evaluate.errors import KeptResults
from manifold.fit.fit_samples import FitSamples
from manifold.fit.principled import fit_bsdf
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.library.store import Library
from manifold.registries import Registry

_RIDGE = 1e-3  # share of the mean variance: of 0.01, 0.001 and 0.0001 the best on the ball


@dataclass(frozen=True, eq=False)
class Task:
    """A left-out material to be completed.

    Attributes:
        others: atoms of the other materials.
        at: cube roots of the atoms at the D candidate directions, shape (n + 1, D).
        roots: cube roots of the material at the candidates, shape (B_s, D).
        wi, wo: the candidate directions, shape (D, 3).
    """

    others: LibraryAtoms
    at: Array
    roots: Array
    wi: Array
    wo: Array

    def readings(self, chosen: Indices) -> Readings:
        """Return readings of the material at some of the directions."""
        nm = self.others.band_axis.wavelengths_nm
        return Readings(
            "left out", "library", self.wi[chosen], self.wo[chosen], None if nm is None else np.array(nm),
            self.roots[:, chosen].T ** 3,
        )  # fmt: skip


Predicted = tuple[Array, Array]
"""f on the grid and on the ball in the bands of the atoms, shapes (P_g, B_s) and (P_b, B_s)."""


@dataclass(frozen=True)
class ReadingMethod:
    """A method that completes readings: its order of directions, its prediction, and its smallest number of readings.

    `order` returns at least the requested number of directions, best first.
    """

    key: str
    title: str
    order: Callable[[Task, int], Indices]
    predict: Callable[[Task, Indices], Predicted]
    least: int = 1


def _from_weights(atoms: LibraryAtoms, weights: Array) -> Predicted:
    """Return predictions of weights (B_s, n + 1) of cube roots; negative cube roots are cut to 0."""
    on_grid, on_ball = atoms.directions[:, : atoms.n_grid], atoms.ball
    return np.maximum(weights @ on_grid, 0.0).T ** 3, np.maximum(weights @ on_ball, 0.0).T ** 3


def _own_order(task: Task, count: int) -> Indices:
    return readings_to_take(task.others, task.at, coordinates(task.wi, task.wo), count)


def _completed(task: Task, chosen: Indices) -> Predicted:
    others, at = task.others.in_atom_bands(), (task.at[:, chosen], np.empty((len(task.at), 0)))
    made = Completion.of(others, Evidence.of_instruments(others, task.readings(chosen), at))
    return made.on_grid, made.on_ball


def _amplitude(task: Task) -> Array:
    return np.cbrt(cosine_weight(task.wi, task.wo))


def _well_conditioned(task: Task, count: int) -> Indices:
    """Return the directions that tell principal components apart best: pivots of a QR factorisation.

    Sources: Nielsen et al. 2015, section 4 (lowest condition number); Businger & Golub 1965 (the greedy choice).
    """
    atoms = task.at[: task.others.n_measured]
    _, _, pivots = qr((atoms - atoms.mean(axis=0)) * _amplitude(task), pivoting=True, mode="economic")
    return np.asarray(pivots[:count], dtype=np.intp)


def _ridge(task: Task, chosen: Indices) -> Predicted:
    """Predict by ridge regression on all principal components of the atoms' cube roots.

    Source: Nielsen et al. 2015, eq. 9.
    """
    n = task.others.n_measured
    atoms, amplitude = task.at[:n, chosen], _amplitude(task)[chosen]
    X = (atoms - atoms.mean(axis=0)) * amplitude
    inner = X @ X.T
    y = (task.roots[:, chosen] - atoms.mean(axis=0)) * amplitude
    shares = np.linalg.solve(inner + _RIDGE * np.trace(inner) / n * np.eye(n), X @ y.T).T
    weights = np.zeros((len(shares), len(task.at)))
    weights[:, :n] = shares + (1.0 - shares.sum(axis=1, keepdims=True)) / n
    return _from_weights(task.others, weights)


def _nearest(task: Task, chosen: Indices) -> Predicted:
    """Predict the material of the library that differs least at the readings."""
    N, amplitude = len(task.others.names), _amplitude(task)[chosen]
    read = task.at[: task.others.n_measured, chosen].reshape(N, -1, len(chosen))
    apart = np.sum(((read - task.roots[:, chosen]) * amplitude) ** 2, axis=(1, 2))
    own = np.flatnonzero(task.others.material_of == int(np.argmin(apart)))
    weights = np.zeros((len(own), len(task.at)))
    weights[np.arange(len(own)), own] = 1.0
    return _from_weights(task.others, weights)


def _principled(task: Task, chosen: Indices) -> Predicted:
    """Predict by Mitsuba's principled BSDF fitted to the readings; NaN if no fit is possible."""
    grid, lights = task.others.grid, panel.judged()
    read = task.readings(chosen)
    try:
        fitted = fit_bsdf(FitSamples.from_arrays(read.wi, read.wo, read.values, bands=read.bands))
    except UsageError:
        empty = [np.full((len(p.wi), read.bands.count), np.nan) for p in (grid, lights)]
        return empty[0], empty[1]
    return fitted.brdf.eval(grid.wi, grid.wo), fitted.brdf.eval(lights.wi, lights.wo)


METHODS: Registry[ReadingMethod] = Registry(
    "method",
    (
        (method.key, method)
        for method in (
            ReadingMethod("completion", "completion, at its directions", _own_order, _completed),
            ReadingMethod("ridge", "ridge regression, at its directions", _well_conditioned, _ridge),
            ReadingMethod("ridge_same", "ridge regression, at those of the completion", _own_order, _ridge),
            ReadingMethod("nearest", "nearest material", _own_order, _nearest),
            ReadingMethod(
                "principled", "principled, fitted to the readings", _own_order, _principled, least=5
            ),
        )
    ),
)


COUNTS = (1, 2, 5, 8, 10, 12, 16, 20, 50)
_MA_T12 = "completion at an MA-T12"
_GLOSS_DEG = (20.0, 60.0)
_KINDS = ("ball", "cube_root", "linear")  # kinds of errors, in the order in which they are kept


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors of one method.

    Attributes:
        counts: numbers of readings.
        errors: errors of every left-out material for each of these numbers, each (N,).
    """

    key: str
    title: str
    counts: tuple[int, ...]
    errors: tuple[Errors[Array], ...]

    @property
    def summary(self) -> list[tuple[int, Errors[float], Errors[float]]]:
        """Number of readings, median and 90th percentile of the errors, for each number whose errors are known."""
        each = zip(self.counts, self.errors, strict=True)
        return [(n, e.median, e.p90) for n, e in each if not np.all(np.isnan(e.ball))]

    def to_json(self) -> dict[str, Any]:
        """Return plain values; a missing error is None."""
        return {
            "key": self.key, "title": self.title, "counts": list(self.counts),
            "errors": plain(self.errors), "program": f"manifold {__version__}",
        }  # fmt: skip


def measure_curves(
    atoms: LibraryAtoms,
    counts: Sequence[int] = COUNTS,
    only: Sequence[str] = (),
    library: Library | None = None,
) -> list[Curve]:
    """Return the errors of completing each library material from the others and n readings, for all or some methods.

    `only` selects methods by their keys. Readings have no noise and are in the bands of the atoms. Every method chooses
    its directions among polar angles 0, 10, ... 80 degrees and azimuths in steps of 30. The last curves are completions
    at the directions of an MA-T12, without and with gloss. Finished materials are kept in the library until the run
    ends, so that an interrupted run continues.
    """
    methods = [METHODS[key] for key in only or METHODS]
    N = len(atoms.names)
    errors = {method.key: np.full((len(counts), N, len(_KINDS)), np.nan) for method in methods}
    kept = KeptResults(library, f"readings-3 {atoms.names} {list(counts)} {list(errors)}")
    errors |= kept.get()
    done = int(errors.pop("done", np.zeros(1))[0])
    wi, wo = all_directions()
    at = atoms.at(wi, wo)
    for m in range(done, N):
        progress.report(m, N, atoms.names[m])
        own = atoms.material_of == m
        task = Task(atoms.without(m), at[~own], at[own], wi, wo)
        for key, of_material in _errors_of(atoms, m, task, counts, methods).items():
            errors[key][:, m] = of_material
        kept.put(errors | {"done": np.array([m + 1])})
    curves = [
        Curve(m.key, m.title, tuple(counts), tuple(Errors(*of_count.T) for of_count in errors[m.key]))
        for m in methods
    ]
    curves += _at_an_ma_t12(atoms, library)
    kept.finish()
    return curves


def _errors_of(
    atoms: LibraryAtoms, m: int, task: Task, counts: Sequence[int], methods: Sequence[ReadingMethod]
) -> dict[str, Array]:
    """Return errors of material m, by method: shape (len(counts), 3), NaN where a method needs more readings."""
    orders = {choose: choose(task, max(counts)) for choose in {method.order for method in methods}}
    errors = {method.key: np.full((len(counts), len(_KINDS)), np.nan) for method in methods}
    for method in methods:
        for k, count in enumerate(counts):
            if count >= method.least:
                chosen = orders[method.order][:count]
                found = errors_of(atoms, m, *method.predict(task, chosen))
                errors[method.key][k] = [getattr(found, kind) for kind in _KINDS]
    return errors


def _at_an_ma_t12(atoms: LibraryAtoms, library: Library | None) -> list[Curve]:
    """Return curves of one number of readings: at the directions of an MA-T12, without gloss and with it."""
    wi, wo = geometry_ma_t12()
    nm, values = atoms.bands.wavelengths_nm, np.ones((len(wi), atoms.bands.count))
    read = Readings("left out", "library", wi, wo, None if nm is None else np.array(nm), values)
    glossy = replace(read, gloss=dict.fromkeys(_GLOSS_DEG, 1.0))
    without, known = (calibrate(atoms, one, library).errors for one in (read, glossy))
    return [
        Curve("ma_t12", _MA_T12, (len(wi),), (without,)),
        Curve(
            "ma_t12_gloss",
            f"{_MA_T12}, with gloss at 20 and 60 degrees",
            (len(wi) + len(_GLOSS_DEG),),
            (known,),
        ),
    ]
