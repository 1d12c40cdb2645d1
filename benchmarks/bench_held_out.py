"""Trials of held-out accuracy: variants of the latent variable models, every material left out once.

    python benchmarks/bench_held_out.py FOLDER                      # every trial, on the .bsdf files of a folder
    python benchmarks/bench_held_out.py FOLDER --trial kernels      # one of them; see --list

The protocol is `manifold.experiments.evaluation.heldout`: fit to N - 1 materials, find the latent of the last by what
it decodes to, compare. Each row changes one thing; `--kernel matern32 --linear 1` all rows. Results:
docs/design/held-out.md.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist
from trial_models import CUBE_ROOT, Kernel, Power, Setting, TrialDecoder, fit, left_out_error, priors

from manifold.brdf.measured import MeasuredBRDF
from manifold.experiments.evaluation.methods import sample_columns
from manifold.experiments.evaluation.tabulated import Data
from manifold.io_rgl import read_bsdf
from manifold.mapping import LogRelative, Mapping
from manifold.metrics import RusinkiewiczGrid
from manifold.models.encoding import PAIR_STRIDE
from manifold.parallel import one_blas_thread
from manifold.records import Array

# -- protocol ----------------------------------------------------------------------------------------------


def held_out(data: Data, setting: Setting, every: int = 1) -> tuple[Array, float]:
    """Relative error of every so manieth material left out, and the largest sum of absolute weights."""
    T = setting.mapping
    bands = _farthest_bands(data, setting) if setting.farthest else data.available_bands(setting.bands)
    within = np.searchsorted(data.bands, bands)
    N, P, _ = data.f.shape
    if setting.whole:
        samples = data.mapped(T).reshape(N, -1)
        weight, group = np.repeat(data.cosines, data.f.shape[2]), 1
    else:
        samples = data.samples(T, bands)
        weight, group = data.cosines, len(bands)
    S = (samples * weight**setting.gram_power) @ samples.T
    stride = slice(None, None, PAIR_STRIDE)
    if setting.whole:
        rows = data.mapped(T)[:, stride].reshape(N, -1)
        cosines = np.repeat(data.cosines[stride], data.f.shape[2])
    else:
        rows, cosines = np.ascontiguousarray(samples[:, stride]), data.cosines[stride]
    left_out = range(0, N, every)
    errors, largest = np.empty(len(left_out)), 0.0
    for k, i in enumerate(left_out):
        others = np.delete(np.arange(N), i)
        columns = sample_columns(others, group)
        with one_blas_thread:
            models = fit(S[np.ix_(columns, columns)], N - 1, samples.shape[1], setting)
            if setting.choose == "likelihood":
                models = models[:1]
            elif setting.choose == "others":
                models = [
                    min(models, key=lambda m: left_out_error(m.process, S[np.ix_(columns, columns)], group))
                ]
            ends = []
            for model in models:
                decoder = TrialDecoder(
                    model.process, setting.structure, group, rows[columns], T, cosines, cosines**setting.gram_power,
                    priors(setting),
                )  # fmt: skip
                f = data.f[i, stride].reshape(1, -1) if setting.whole else data.f[i, stride].T  # [R, P]
                seen = f if setting.whole else f[within]
                first = None
                if model.encode is not None:
                    own = np.arange(i * group, (i + 1) * group)
                    first = model.encode(S[np.ix_(own, columns)], np.diag(S)[own])
                x = first if setting.back_only and first is not None else decoder.ends(seen, setting, first)
                V = model.process.weights(_all_bands(data, setting, decoder, x, f, bands))
                mapped = V @ samples[columns]
                shape = (P, -1) if setting.whole else (-1, P)
                mapped = mapped.reshape(shape) if setting.whole else mapped.reshape(shape).T
                predicted = np.maximum(T.inverse(mapped, data.cosines), 0.0)
                ends.append((data.relative_error(i, predicted), float(np.abs(V).sum(axis=1).max())))
        errors[k], most = min(ends)
        largest = max(largest, most)
    return errors, largest


def _all_bands(
    data: Data, setting: Setting, decoder: TrialDecoder, x: Array, f: Array, bands: Array
) -> Array:
    """Latents of all the data's bands from those of the sample bands."""
    if setting.whole or len(bands) == len(data.bands):
        return x
    Qs = setting.structure
    if setting.interpolate or setting.colour > 1:
        colours = np.column_stack([np.interp(data.bands, bands, c) for c in x[:, Qs:].T])
    else:
        colours = decoder.encode_colours(x[0, :Qs], f)
    return np.hstack([np.tile(x[0, :Qs], (len(data.bands), 1)), colours])


def _farthest_bands(data: Data, setting: Setting) -> Array:
    """Bands whose mapped values differ most from those chosen before, over all materials; the ends come first."""
    flat = np.moveaxis(data.mapped(setting.mapping), 2, 0)[..., ::PAIR_STRIDE]
    flat = (flat * np.sqrt(data.cosines[::PAIR_STRIDE])).reshape(len(data.bands), -1)
    chosen = [0, len(data.bands) - 1]
    while len(chosen) < setting.bands:
        chosen.append(int(cdist(flat, flat[chosen]).min(axis=1).argmax()))
    return data.bands[np.sort(chosen)]


# -- trials ------------------------------------------------------------------------------------------------

MONO_2, MONO_3 = Setting(), Setting(structure=3)
WHOLE_2 = Setting(0, 2, True, Kernel(mu=1e-4), prior=0.0, n_starts=1)
WHOLE_6 = replace(WHOLE_2, colour=6, prior=0.1)
MODELS = {"whole 2": WHOLE_2, "whole 6": WHOLE_6, "mono 2+1": MONO_2, "mono 3+1": MONO_3}


def _mu(setting: Setting, mu: float) -> Setting:
    return replace(setting, kernel=replace(setting.kernel, mu=mu))


def trials(data: Data) -> dict[str, dict[str, Setting]]:
    """Name of a trial -> name of a row -> setting."""
    outputs = data.f.shape[1]
    monochrome = {"mono 2+1": MONO_2, "mono 3+1": MONO_3}
    kernels: dict[str, dict[str, Any]] = {
        "SE": {"name": "se"}, "Matern 3/2": {"name": "matern32"}, "Matern 5/2": {"name": "matern52"},
        "RQ, alpha 0.5": {"name": "rq", "alpha": 0.5}, "RQ, alpha 1": {"name": "rq"},
        "RQ, alpha 2": {"name": "rq", "alpha": 2.0},
        "SE + 0.01 linear": {"linear": 0.01}, "SE + 0.1 linear": {"linear": 0.1}, "SE + linear": {"linear": 1.0},
    }  # fmt: skip
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
            f"{name}, mu {mu:g}": _mu(s, mu)
            for name, s in MODELS.items()
            for mu in (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 1e-1)
        } | {f"{name}, mu by likelihood": replace(s, learn=("mu",)) for name, s in MODELS.items()},
        "ard": {
            f"{name}, length scales by likelihood": replace(s, learn=("ard",)) for name, s in MODELS.items()
        },
        "kernels": {
            f"{name}, {title}": replace(s, kernel=replace(s.kernel, **kernel))
            for name, s in MODELS.items()
            for title, kernel in kernels.items()
        },
        "linear": {
            f"{name}, SE + {weight:g} linear, mu {mu:g}, prior {prior:g}": replace(
                s, kernel=Kernel(mu=mu, linear=weight), prior=prior
            )
            for name, s in MODELS.items()
            if name != "whole 2"
            for weight in (0.3, 1.0, 3.0, 10.0)
            for mu in (1e-4, 3e-4, 1e-3, 3e-3)
            for prior in (0.03, 0.1, 0.3)
        },
        "back": {
            f"{name}, {kind} encoder" + (", alone" if alone else ", then searched"): replace(
                s, back=kind, back_only=alone
            )
            for name, s in MODELS.items()
            for kind in ("linear", "rbf")
            for alone in (False, True)
        },
        "starts": {
            f"{name}, {count} starts, best by {choose}": replace(s, n_starts=count, choose=choose)
            for name, s in MODELS.items()
            for count, choose in (
                (1, "likelihood"), (2, "likelihood"), (8, "likelihood"), (2, "others"), (8, "others"), (8, "held-out")
            )
        },
        "encoder": {f"{name}, every end polished": replace(s, encoder="all") for name, s in MODELS.items()},
        "mapping": {
            f"{name}, {title}": replace(s, mapping=mapping)
            for name, s in (*monochrome.items(), ("whole 6", WHOLE_6))
            for title, mapping in mappings.items()
        },
        "gram": {
            f"{name}, Gram weight cos^{power:.2g}, mu {mu:g}": _mu(replace(s, gram_power=power), mu)
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
            f"mono 2+1, {count} {'farthest' if far else 'even'} bands, colours {'interpolated' if line else 'solved'}":
            replace(MONO_2, bands=count, farthest=far, interpolate=line)
            for count, far, line in (
                (3, False, False), (5, False, False), (7, False, False), (9, False, False), (13, False, False),
                (3, True, False), (5, True, False), (7, True, False),
                (5, False, True), (9, False, True), (13, False, True), (7, True, True),
            )
        }  # fmt: skip
        table["bands"] |= {
            f"mono 3+1, {count} even bands, colours solved": replace(MONO_3, bands=count) for count in (3, 5)
        }
    return table


def load(folder: Path, cache: Path | None) -> Data:
    """Values of the files of a folder, remembered in an .npz."""
    if cache is not None and cache.exists():
        kept = np.load(cache)
        return Data(kept["f"], kept["cosines"], kept["bands"], int(kept["n_bands"]))
    paths = sorted(folder.glob("*.bsdf"))
    if len(paths) < 4:
        raise SystemExit(f"{folder}: found {len(paths)} .bsdf files, expected at least 4")
    materials = [MeasuredBRDF(read_bsdf(path)) for path in paths]
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default"))
    if cache is not None:
        np.savez(cache, f=data.f, cosines=data.cosines, bands=data.bands, n_bands=data.n_bands)
    return data


def main() -> None:
    """Print a table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trial", action="append", help="may be given several times")
    parser.add_argument(
        "--kernel", dest="name", choices=("se", "matern32", "matern52", "rq"), help="of every model"
    )
    parser.add_argument("--linear", type=float, help="add a linear term of this weight to every kernel")
    parser.add_argument("--mu", type=float, help="noise filter of every kernel")
    parser.add_argument("--rows", default="", help="only rows whose name this regular expression finds")
    parser.add_argument(
        "--every", type=int, default=1, help="leave out only every so manieth material, to save time"
    )
    parser.add_argument("--list", action="store_true", help="names of trials and rows")
    parser.add_argument("--cache", type=Path, help="file that remembers the evaluated data (.npz)")
    parser.add_argument("--json", type=Path, help="where to append results, one JSON object per line")
    args = parser.parse_args()
    data = load(args.folder, args.cache)
    table = trials(data)
    for trial in args.trial or table:
        print(f"\n{trial}\n| row | geometric mean | median | 90th pct. | largest sum of weights | seconds |")
        print("|---|---|---|---|---|---|")
        for name, setting in table[trial].items():
            if not re.search(args.rows, name):
                continue
            if args.list:
                print(f"| {name} |")
                continue
            changes = {
                key: value for key in ("name", "linear", "mu") if (value := getattr(args, key)) is not None
            }
            setting = replace(setting, kernel=replace(setting.kernel, **changes))
            start = time.perf_counter()
            errors, largest = held_out(data, setting, args.every)
            row = {
                "trial": trial, "row": name, "mean": float(np.exp(np.mean(np.log(errors)))),
                "median": float(np.median(errors)), "p90": float(np.percentile(errors, 90)), "weights": largest,
                "seconds": time.perf_counter() - start, "errors": errors.tolist(),
            }  # fmt: skip
            print(
                f"| {name} | {row['mean']:.3f} | {row['median']:.3f} | {row['p90']:.3f} | {largest:.0f} "
                f"| {row['seconds']:.0f} |",
                flush=True,
            )
            if args.json is not None:
                with args.json.open("a") as file:
                    file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
