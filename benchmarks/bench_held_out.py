"""Trials of held-out accuracy: variants of the latent variable models, every material left out once.

    python benchmarks/bench_held_out.py FOLDER                      # every trial, on the .bsdf files of a folder
    python benchmarks/bench_held_out.py FOLDER --trial kernels      # one of them; see --list

The protocol is that of reports (`manifold.experiments.evaluation.cross_validation`): fit to N - 1 materials, find the
latent of the last from its data, compare what it decodes to. Each row changes one thing; `--kernel matern32+linear`
all rows. Results: docs/explanation/gplvm.md.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from trial_models import CUBE_ROOT, Power, Setting, fit_trial

from manifold.brdf.measured import MeasuredBRDF
from manifold.experiments.evaluation.cross_validation import cross_validate, leave_out
from manifold.experiments.evaluation.errors import BallErrors
from manifold.experiments.evaluation.tabulated import Data
from manifold.io_rgl import read_bsdf
from manifold.latent.criteria import CRITERIA
from manifold.latent.kernels import KERNELS, kernel_named
from manifold.mapping import LogRelative, Mapping
from manifold.metrics import RusinkiewiczGrid, cube_root_error, relative_error


@dataclass(frozen=True)
class Row:
    """The three errors of every material that was left out, and the largest sum of absolute weights."""

    linear: list[float]
    cube_root: list[float]
    ball: list[float]
    weights: float


def held_out(data: Data, balls: BallErrors, setting: Setting, every: int = 1) -> Row:
    """Leave every Nth material out."""
    splits = leave_out(data.n_materials)[::every]
    found = cross_validate(data, fit_trial(setting), splits).combinations
    linear, cube_root, ball = [], [], []
    for (_, out), combination in zip(splits, found, strict=True):
        i, here = int(out[0]), combination.in_bands(data.bands)
        f = here.evaluate(data)
        linear.append(relative_error(data.f[i], f, data.cosines))
        cube_root.append(cube_root_error(data.f[i], f, data.cosines))
        ball.append(balls.differences(i, here.evaluate(balls.values))[0])
    return Row(linear, cube_root, ball, max(float(np.abs(c.weights).sum(axis=-1).max()) for c in found))


def _mean(errors: list[float]) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(errors))))


def _both(errors: list[float], digits: int = 3) -> str:
    """Median / 90th percentile."""
    return f"{np.median(errors):.{digits}f} / {np.percentile(errors, 90):.{digits}f}"


# -- trials ------------------------------------------------------------------------------------------------

MONO_2, MONO_3 = Setting(), Setting(structure=3)
WHOLE_2 = Setting(0, 2, True, kernel_named("se", 1e-4), prior=0.0, n_starts=1)
WHOLE_6 = replace(WHOLE_2, colour=6, prior=0.1)
MODELS = {"whole 2": WHOLE_2, "whole 6": WHOLE_6, "mono 2+1": MONO_2, "mono 3+1": MONO_3}


def _kernel(setting: Setting, name: str | None = None, **changed: float) -> Setting:
    """The setting under another kernel, or with another mu or weight of the linear term."""
    kernel = setting.kernel if name is None else kernel_named(name, setting.kernel.mu)
    return replace(setting, kernel=replace(kernel, **changed))


def trials(data: Data) -> dict[str, dict[str, Setting]]:
    """Name of a trial -> name of a row -> setting."""
    outputs = data.f.shape[1]
    monochrome = {"mono 2+1": MONO_2, "mono 3+1": MONO_3}
    mappings: dict[str, Mapping] = {
        "square root": Power(2.0), "2.5th root": Power(2.5), "cube root": CUBE_ROOT, "4th root": Power(4.0),
        "6th root": Power(6.0), "log-relative, 1e-3": LogRelative(), "log-relative, 1e-2": LogRelative(epsilon=1e-2),
        "log-relative, 1e-1": LogRelative(epsilon=1e-1),
    }  # fmt: skip
    table: dict[str, dict[str, Setting]] = {
        "base": MODELS,
        "prior": {
            f"{name}, prior {prior:.2g}": replace(s, prior=prior)
            for name, s in MODELS.items()
            for prior in (0.0, 1.0 / outputs, 1e-3, 0.01, 0.03, 0.1, 0.3, 1.0)
        },
        "prior-split": {
            f"{name}, prior {a:g} structure, {b:g} colour": replace(s, prior=a, prior_colour=b)
            for name, s in monochrome.items()
            for a, b in ((0.03, 0.1), (0.03, 0.3), (0.1, 0.01), (0.1, 0.03), (0.1, 0.3), (0.3, 0.03), (0.3, 0.1))
        },
        "noise": {
            f"{name}, mu {mu:g}": _kernel(s, mu=mu)
            for name, s in MODELS.items()
            for mu in (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 1e-1)
        } | {f"{name}, mu by likelihood": replace(s, learn=("mu",)) for name, s in MODELS.items()},
        "ard": {
            f"{name}, length scales by likelihood": replace(s, learn=("ard",)) for name, s in MODELS.items()
        },
        "kernels": {
            f"{name}, {kernel}": _kernel(s, kernel) for name, s in MODELS.items() for kernel in KERNELS
        } | {
            f"{name}, se + {weight:g} linear": _kernel(s, linear=weight)
            for name, s in MODELS.items()
            for weight in (0.01, 0.1)
        },
        "linear": {
            f"{name}, {family} + {weight:g} linear, mu {mu:g}, prior {prior:g}": replace(
                _kernel(s, family, linear=weight, mu=mu), prior=prior
            )
            for name, s in MODELS.items()
            if name != "whole 2"
            for family in ("se", "matern32")
            for weight in (0.3, 1.0, 3.0, 10.0)
            for mu in (1e-4, 3e-4, 1e-3, 3e-3)
            for prior in (0.03, 0.1, 0.3)
        },
        "criterion": {
            f"{name}, by {criterion}": replace(s, criterion=criterion)
            for name, s in MODELS.items()
            for criterion in CRITERIA
        },
        "starts": {
            f"{name}, {count} starts, best by {choose}": replace(s, n_starts=count, choose=choose)
            for name, s in MODELS.items()
            for count, choose in (
                (1, "likelihood"), (2, "likelihood"), (8, "likelihood"), (2, "others"), (8, "others"), (8, "held-out")
            )
        },
        "mapping": {
            f"{name}, {title}": replace(s, mapping=mapping)
            for name, s in (*monochrome.items(), ("whole 6", WHOLE_6))
            for title, mapping in mappings.items()
        },
        "gram": {
            f"{name}, Gram weight cos^{power:.2g}, mu {mu:g}": _kernel(replace(s, gram_power=power), mu=mu)
            for name, s in monochrome.items()
            for power in (1.0, 2.0 / 3.0, 1.0 / 3.0)
            for mu in (1e-4, 1e-3)
        },
        "size": {
            f"mono {a}+{b}": replace(MONO_2, structure=a, colour=b)
            for a, b in ((0, 2), (1, 1), (2, 1), (3, 1), (4, 1), (5, 1), (6, 1), (8, 1), (0, 4), (0, 6), (2, 2), (3, 2))
        } | {f"whole {q}": replace(WHOLE_6, colour=q) for q in (1, 2, 3, 4, 5, 6, 8, 10)},
    }  # fmt: skip
    if data.n_bands > data.f.shape[2]:
        table["bands"] = {
            f"mono 2+1, {count} {'farthest' if far else 'even'} bands": replace(MONO_2, bands=count, farthest=far)
            for count, far in (
                (3, False), (5, False), (7, False), (9, False), (13, False), (3, True), (5, True), (7, True)
            )
        }  # fmt: skip
        table["bands"] |= {f"mono 3+1, {count} even bands": replace(MONO_3, bands=count) for count in (3, 5)}
    return table


def load(folder: Path) -> list[MeasuredBRDF]:
    """The .bsdf files of a folder, as they are."""
    paths = sorted(folder.glob("*.bsdf"))
    if len(paths) < 4:
        raise SystemExit(f"{folder}: found {len(paths)} .bsdf files, expected at least 4")
    return [MeasuredBRDF(read_bsdf(path)) for path in paths]


def main() -> None:
    """Print a table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trial", action="append", help="may be given several times")
    parser.add_argument("--kernel", choices=KERNELS, help="of every model")
    parser.add_argument("--mu", type=float, help="noise filter of every kernel")
    parser.add_argument("--criterion", choices=CRITERIA, help="by which all materials are encoded")
    parser.add_argument("--rows", default="", help="only rows whose name this regular expression finds")
    parser.add_argument(
        "--every", type=int, default=1, help="leave out only every Nth material, to save time"
    )
    parser.add_argument("--list", action="store_true", help="names of trials and rows")
    parser.add_argument("--json", type=Path, help="where to append results, one JSON object per line")
    args = parser.parse_args()
    materials = load(args.folder)
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default"))
    balls = BallErrors(materials, data.bands)
    table = trials(data)
    for trial in args.trial or table:
        print(f"\n{trial}\n| row | linear | cube root | ball CIEDE2000 | largest sum of weights | seconds |")
        print("|---|---|---|---|---|---|")
        for name, setting in table[trial].items():
            if not re.search(args.rows, name):
                continue
            if args.list:
                print(f"| {name} |")
                continue
            if args.kernel is not None:
                setting = _kernel(setting, args.kernel)
            if args.mu is not None:
                setting = _kernel(setting, mu=args.mu)
            if args.criterion is not None:
                setting = replace(setting, criterion=args.criterion)
            start = time.perf_counter()
            found = held_out(data, balls, setting, args.every)
            row = {"trial": trial, "row": name, "seconds": time.perf_counter() - start, **asdict(found)}
            print(
                f"| {name} | {_mean(found.linear):.3f} ({_both(found.linear)}) | {_mean(found.cube_root):.3f} "
                f"({_both(found.cube_root)}) | {_both(found.ball, 1)} | {found.weights:.0f} | {row['seconds']:.0f} |",
                flush=True,
            )
            if args.json is not None:
                with args.json.open("a") as file:
                    file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
