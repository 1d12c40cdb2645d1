"""Three errors of left-out materials against the number of readings that they are completed from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from manifold import __version__, progress
from manifold.errors import UsageError
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.expected import calibrate, errors_of
from manifold.estimate.suggestions import all_directions
from manifold.evaluate.reading_methods import METHODS, ReadingMethod, Task
from manifold.evaluate.results import KeptResults, finite
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.library.store import Library
from manifold.metrics import Errors
from manifold.records import Array

COUNTS = (1, 2, 5, 8, 10, 12, 16, 20, 50)
_MA_T12 = "completion at an MA-T12"
_GLOSS_DEG = (20.0, 60.0)
_KINDS = ("ball", "cube_root", "linear")  # of errors, in the order in which they are kept


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors of one method.

    Attributes:
        key, title: of the method.
        counts: numbers of readings.
        errors: of every left-out material at each of these numbers, each (N,).
    """

    key: str
    title: str
    counts: tuple[int, ...]
    errors: tuple[Errors[Array], ...]

    @property
    def summary(self) -> list[tuple[int, Errors[float], Errors[float]]]:
        """Numbers of readings, medians and 90th percentiles there, where any material has errors."""
        each = zip(self.counts, self.errors, strict=True)
        return [(n, e.median, e.p90) for n, e in each if not np.all(np.isnan(e.ball))]

    def to_json(self) -> dict[str, Any]:
        """Plain values; None where a method has no error."""
        return {
            "key": self.key, "title": self.title, "counts": list(self.counts),
            "errors": finite([errors.to_json() for errors in self.errors]), "program": f"manifold {__version__}",
        }  # fmt: skip


def measure_curves(
    atoms: LibraryAtoms,
    counts: Sequence[int] = COUNTS,
    only: Sequence[str] = (),
    library: Library | None = None,
) -> list[Curve]:
    """Complete every material of a library from the others, from n readings, by every method.

    Readings are without noise, in the bands of the atoms. Every method chooses its directions, among elevations from 0
    to 80 degrees by 10 and azimuths by 30; the last curves are the completion at the directions of an MA-T12, without
    gloss and with it.

    Args:
        atoms: of the library.
        counts: n, increasing.
        only: keys of methods; all by default.
        library: where materials that are done are kept until all are, so that an interrupted run is continued.
    Raises:
        UsageError: there is no such method.
    """
    known = {method.key: method for method in METHODS}
    missing = [key for key in only if key not in known]
    if missing:
        raise UsageError(f"no method '{missing[0]}', expected one of {', '.join(known)}")
    methods = [known[key] for key in only] if only else list(METHODS)
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
    """Errors of material m, by method: shape (len(counts), 3), NaN where a method needs more readings."""
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
    """Curves of one number of readings: at the directions of an MA-T12, without gloss and with it."""
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
