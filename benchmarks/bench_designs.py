"""Designs of few readings for MERL materials: rendered errors of completions and of ridge regression.

    python benchmarks/bench_designs.py NEURAL [--every K] [--json FILE]

NEURAL holds published neural fits (`neural_fits.py`), of which those of MERL materials take part. Every K-th is left
out and completed from the others, from 8 and from 16 exact readings. Directions are those that `--suggest` names
before any reading; those that it names in fours, each time after the readings before; those of the lowest condition
number that a search for each number of readings finds (Nielsen et al. 2015); pivots of a QR factorisation; and
five random draws (medians over the draws, and the range of their medians or means). Errors are the ball error, and
the mean PSNR in dB of the ball's five pictures in linear sRGB between 0 and 1, as published designs are judged. The
library, the renderings and the split are not those of published studies.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bench_completion_errors import atoms_of
from bench_counts import PREDICT, random, ridge_of_nielsen
from completion_baselines import LOGARITHMS
from neural_fits import read_neural_fits

from manifold.colour import panel
from manifold.core.pairs import cosine_weight
from manifold.core.records import Array, Indices
from manifold.estimate import Completion, LibraryAtoms
from manifold.estimate.evidence import Evidence
from manifold.estimate.expected import errors_of
from manifold.estimate.residual import coordinates
from manifold.estimate.suggestions import all_directions, readings_to_take
from manifold.evaluate.readings import METHODS, Task

COUNTS = (8, 16)
STEP = 4  # readings between two suggestions
DRAWS = 5
STARTS, EXCHANGES = 6, 400
"""Random starts of a search for the lowest condition number, and exchanges tried from each."""
METHODS_COMPARED = {
    "completion": PREDICT["completion"],
    "ridge": PREDICT["ridge"],
    "nielsen": ridge_of_nielsen,
}


def in_fours(task: Task, count: int) -> Indices:
    """Return suggested directions, four at a time, each time from the completion of the readings so far."""
    others, where = task.others, coordinates(task.wi, task.wo)
    chosen = readings_to_take(others, task.at, where, STEP)
    while len(chosen) < count:
        at = task.at[:, chosen], np.empty((len(task.at), 0))
        plain = others.in_atom_bands()
        known = Completion.of(plain, Evidence.of_instruments(plain, task.readings(chosen), at))
        left = np.setdiff1d(np.arange(len(task.wi)), chosen)
        found = readings_to_take(others, task.at[:, left], where[left], STEP, known)
        chosen = np.append(chosen, left[found])
    return chosen[:count]


def lowest_condition(task: Task, count: int) -> Indices:
    """Return directions at which scaled principal components of logarithms have a low condition number.

    From each random start, single directions are exchanged at random, and an exchange that lowers the condition number
    is kept. Source: Nielsen et al. 2015, section 4, who follow the gradient from random starts.
    """
    amplitude = np.maximum(cosine_weight(task.wi, task.wo), 1e-3)
    logs = LOGARITHMS.forward(task.at[: task.others.n_measured].T ** 3 * amplitude[:, None])
    logs -= logs.mean(axis=1, keepdims=True)
    # The scores of all principal components have the same inner products as the centred samples.
    inner, rng = logs @ logs.T, np.random.default_rng(0)

    def condition(chosen: Indices) -> float:
        values = np.linalg.eigvalsh(inner[np.ix_(chosen, chosen)])
        return float(values[-1] / max(values[0], np.finfo(float).tiny))

    ends: list[tuple[float, Indices]] = []
    for _ in range(STARTS):
        chosen = rng.choice(len(inner), count, replace=False)
        lowest = condition(chosen)
        for _ in range(EXCHANGES):
            tried = chosen.copy()
            tried[rng.integers(count)] = rng.choice(np.setdiff1d(np.arange(len(inner)), chosen))
            if (found := condition(tried)) < lowest:
                chosen, lowest = tried, found
        ends.append((lowest, chosen))
    return min(ends, key=lambda end: end[0])[1]


DESIGNS: dict[str, Callable[[Task, int], Indices]] = {
    "suggested": METHODS["completion"].order,
    "suggested in fours": in_fours,
    "condition": lowest_condition,
    "pivots": METHODS["ridge"].order,
    **{f"random {draw}": random(draw) for draw in range(DRAWS)},
}
"""Directions, best first. Those of `condition` are searched for each number of readings."""


def psnr(atoms: LibraryAtoms, m: int, on_ball: Array) -> float:
    """Return the mean PSNR of the five pictures of a ball against material m, in dB; both in linear sRGB, clipped."""
    lights = panel.judged()
    own = np.flatnonzero(atoms.material_of == m)
    pictures = [np.clip(lights.of(f), 0.0, 1.0) for f in (atoms.ball[own].T ** 3, on_ball)]
    of_lights = np.split((pictures[0] - pictures[1]) ** 2, np.cumsum(lights.counts)[:-1])
    return float(np.mean([-10.0 * np.log10(max(float(each.mean()), 1e-12)) for each in of_lights]))


def main() -> None:
    """Print and keep median and 90th percentile of the ball error, mean and 10th percentile of the PSNR."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("neural", type=Path)
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    fits = {name: fit for name, fit in read_neural_fits(asked.neural).items() if not fit.is_rgl}
    with tempfile.TemporaryDirectory() as scratch:
        atoms = atoms_of(Path(scratch), fits)
        tried = range(0, len(atoms.names), asked.every)
        wi, wo = all_directions()
        at = atoms.at(wi, wo)
        errors: dict[str, list[tuple[float, float]]] = {}
        for m in tried:
            own = atoms.material_of == m
            task = Task(atoms.without(m), at[~own], at[own], wi, wo)
            for design, order in DESIGNS.items():
                longest = order(task, max(COUNTS))
                for count in COUNTS:
                    chosen = order(task, count) if design == "condition" else longest[:count]
                    for method, predict in METHODS_COMPARED.items():
                        on_grid, on_ball = predict(task, chosen)
                        found = errors_of(atoms, m, on_grid, on_ball).ball, psnr(atoms, m, on_ball)
                        errors.setdefault(f"{design} {method} {count}", []).append(found)
    rows: dict[str, dict[str, list[float]]] = {}
    for key, of_key in errors.items():
        ball, decibels = np.array(of_key).T
        rows[key.replace(" ", "_")] = {
            "ball": [float(np.median(ball)), float(np.percentile(ball, 90))],
            "psnr": [float(np.mean(decibels)), float(np.percentile(decibels, 10))],
        }
    for method in METHODS_COMPARED:
        for count in COUNTS:
            draws = [rows.pop(f"random_{draw}_{method}_{count}") for draw in range(DRAWS)]
            both = {kind: np.array([draw[kind] for draw in draws]) for kind in draws[0]}
            row = rows[f"random_{method}_{count}"] = {
                kind: np.median(of_draws, axis=0).tolist() for kind, of_draws in both.items()
            }
            row |= {f"{kind}_range": [np.min(of[:, 0]), np.max(of[:, 0])] for kind, of in both.items()}
    for key, row in rows.items():
        print(key, json.dumps(row))
    if asked.json:
        asked.json.write_text(
            json.dumps({"materials": len(atoms.names), "tried": len(tried), **rows}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
