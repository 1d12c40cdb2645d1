"""Thousands of materials: time and memory of import, embedding with calibration, predictions and the map.

    python benchmarks/bench_scale.py [--sizes 50,150,500,1500,5000] [--steps import,embed] [--figure FILE.png]
                                     [--json FILE]
    python benchmarks/bench_scale.py --compare LIBRARY [--landmarks 0,50] [--latent-dim Q] [--json FILE]

Materials are generated: analytic ones of six kinds with random parameters, as RGB files of 16 x 16 cells and five
incidences. Every step of every size runs in a process of its own, whose processor time, wall time and peak memory are
measured. The exponent of a step is the slope of log processor time over log size, of the two largest sizes. A map's
detour (median and 90th percentile) and share of kept neighbours are those that `embed` prints, of 200 materials.

With --compare, maps of one library by different numbers of landmarks (0: all materials are laid out): errors of
materials that are left out, median / 90th percentile, the rank correlation of expected errors with them, detour and
kept neighbours, and the share of random latents inside the hull whose highlight has a hole of over 10 %. Results are
added to those of a --json file.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bench_interior import Interior

from manifold.analytic.base import Sheen
from manifold.analytic.diffuse import RoughDiffuse
from manifold.analytic.ggx import GGX
from manifold.analytic.layers import Layered, MixedBRDF
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.plausibility import plausibility
from manifold.core.records import Bands
from manifold.estimate.predictions import predict
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.model.manifold import Manifold
from manifold.model.settings import BlendSettings
from manifold.page.explore import write_page
from manifold.pictures.maps import latent_map

SIZES = (50, 150, 500, 1500, 5000)
RGB = Bands(None)
NODES, INCIDENCES, WARP_NODES = 16, 5, 32  # of generated files
STEPS = ("import", "embed", "predict", "map", "page")
ERRORS = ("ball", "blended_ball", "cube_root")  # of the comparison
PREDICTIONS = 10
PLACES = 100  # random latents of a seed of the comparison

Run = dict[str, float]


def random_material(rng: np.random.Generator) -> BRDF:
    """An analytic material: paint, cloth, metal, lacquered metal, satin or plastic."""
    colour = np.clip(rng.beta(0.8, 1.6, 3) * rng.uniform(0.2, 1.0), 0.01, 0.9)
    ggx = GGX.isotropic(float(np.exp(rng.uniform(np.log(0.06), np.log(0.7)))))
    eta = np.full(3, rng.uniform(1.35, 1.7))
    root = np.sqrt(np.clip(rng.uniform(0.3, 0.95) * rng.uniform(0.5, 1.0, 3), 0.05, 0.95))
    metal = RoughConductor(ggx, (1.0 + root) / (1.0 - root), np.zeros(3), RGB)
    matte, plastic = RoughDiffuse(colour, rng.uniform(0.0, 0.8), RGB), Plastic(ggx, eta, colour, RGB)
    kinds: list[Callable[[], BRDF]] = [
        lambda: matte,
        lambda: Layered(Sheen(rng.uniform(0.2, 0.7), rng.uniform(0.05, 0.4) * np.sqrt(colour), RGB), matte),
        lambda: metal,
        lambda: MixedBRDF([(0.5, metal), (0.5, plastic)]),
        lambda: MixedBRDF([(0.5, matte), (0.5, plastic)]),
        lambda: plastic,
    ]
    return kinds[rng.integers(len(kinds))]()


def write_materials(folder: Path, first: int, last: int) -> None:
    """Files of the materials of these numbers, which follow from the number alone."""
    goniometer.WARP_NODES = WARP_NODES  # the files of the database have 128, half a megabyte of them
    for k in range(first, last):
        path = folder / f"material_{k:05d}_rgb.bsdf"
        if not path.exists():
            brdf = random_material(np.random.default_rng([0, k]))
            write_bsdf(
                path, goniometer.measure(brdf, f"material_{k:05d}", resolution=NODES, n_theta_i=INCIDENCES)
            )


def measured(step: Callable[..., None], *arguments: object) -> Run:
    """Processor seconds, wall seconds, and peak memory in GB of a step in a process of its own."""
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    process = context.Process(target=_run, args=(queue, step, arguments))
    process.start()
    found: Run = queue.get()
    process.join()
    return found


def _run(queue: multiprocessing.Queue[Run], step: Callable[..., None], arguments: tuple[object, ...]) -> None:
    start, used = time.perf_counter(), time.process_time()
    step(*arguments)
    used, wall = time.process_time() - used, time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    queue.put({"cpu_s": used, "wall_s": wall, "memory_gb": peak})


def import_step(library: Path, files: list[Path]) -> None:
    """Import files."""
    assert not import_files(library, files).failed


def embed_step(library: Path, model: Path) -> None:
    """Embed with calibration."""
    Manifold.fit(library).save(model)


def predict_step(model: Path) -> None:
    """Predict at random latents, from loading the model to files."""
    loaded = Manifold.load(model)
    rng = np.random.default_rng(0)
    for k in range(PREDICTIONS):
        shares = rng.dirichlet(np.ones(3))
        x = shares @ loaded.X[rng.choice(len(loaded.X), 3, replace=False)]
        predict(loaded, x, model.parent / f"predicted_{k}.bsdf")


def map_step(model: Path) -> None:
    """Draw the map."""
    latent_map(model, model.parent / "map.png")


def page_step(model: Path) -> None:
    """Write the page."""
    write_page(model, model.parent / "page.html")


def coherence_of(model: Manifold) -> dict[str, Any]:
    """How well a map keeps similar materials together, as `embed` measured it."""
    found = model.coherence
    assert found is not None
    return {
        "detour": [found.detour, found.detour_p90], "far_percent": round(100.0 * found.detour_far),
        "kept_percent": round(100.0 * found.neighbours_kept),
    }  # fmt: skip


def run_sizes(
    sizes: list[int], folder: Path, chosen: list[str]
) -> tuple[dict[str, list[Run]], dict[str, dict[str, object]]]:
    """Run the chosen steps at every size; return their times, and the coherence of the maps by size."""
    files = folder / "files"
    files.mkdir(parents=True, exist_ok=True)
    rows: dict[str, list[Run]] = {step: [] for step in chosen}
    coherences: dict[str, dict[str, object]] = {}
    for size in sizes:
        here = folder / str(size)
        here.mkdir(exist_ok=True)
        write_materials(files, 0, size)
        library, model = here / "library.zarr", here / "model.h5"
        steps: dict[str, tuple[Callable[..., None], list[object]]] = {
            "import": (import_step, [library, sorted(files.iterdir())[:size]]), "embed": (embed_step, [library, model]),
            "predict": (predict_step, [model]), "map": (map_step, [model]), "page": (page_step, [model]),
        }  # fmt: skip
        for name in chosen:
            step, arguments = steps[name]
            found = measured(step, *arguments)
            rows[name].append(found)
            print(size, name, {key: round(value, 2) for key, value in found.items()}, flush=True)
        written = [path for path in (model, here / "page.html") if path.exists()]
        sizes_of = ", ".join(f"{path.name} {path.stat().st_size / 1e6:.1f} MB" for path in written)
        coherences[str(size)] = coherence_of(Manifold.load(model))
        print(f"{size}: {sizes_of}; {coherences[str(size)]}", flush=True)
    return rows, coherences


def print_table(sizes: list[int], rows: dict[str, list[Run]]) -> None:
    """Processor seconds and gigabytes of every step and size, and exponents."""
    print("| step | " + " | ".join(f"{size:,}" for size in sizes) + " | exponent |")
    print("|---" * (len(sizes) + 2) + "|")
    for step, runs in rows.items():
        cells = [f"{run['cpu_s']:.1f} s ({run['wall_s']:.0f}), {run['memory_gb']:.2f} GB" for run in runs]
        print(f"| {step} | " + " | ".join(cells) + f" | {exponent(sizes, runs):.2f} |")


def exponent(sizes: list[int], runs: list[Run]) -> float:
    """Slope of log processor time over log size between the two largest sizes."""
    if len(sizes) < 2:
        return float("nan")
    return float(np.log(runs[-1]["cpu_s"] / runs[-2]["cpu_s"]) / np.log(sizes[-1] / sizes[-2]))


def draw(sizes: list[int], rows: dict[str, list[Run]], path: Path) -> None:
    """Processor time and memory over the number of materials."""
    from manifold.pictures.figures import new_figure, save

    figure = new_figure(10, 4.2)
    for axes, key, label in zip(
        figure.subplots(1, 2), ("cpu_s", "memory_gb"), ("processor time (s)", "peak memory (GB)"), strict=True
    ):
        for (step, runs), marker in zip(rows.items(), "osD^v", strict=False):
            label_of = f"{step}, exponent {exponent(sizes, runs):.2f}" if key == "cpu_s" else step
            axes.plot(sizes, [run[key] for run in runs], marker=marker, label=label_of)
        axes.set(xscale="log", yscale="log", xlabel="materials", ylabel=label)
        axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save(figure, path)


def compare(library: Path, landmarks: list[int], latent_dim: int) -> dict[str, dict[str, object]]:
    """A row per number of landmarks, printed too."""
    of_errors = [f"{kind}: left out, rank correlation" for kind in ERRORS]
    print(" | ".join(["| landmarks", *of_errors, "detour", "kept", "holes", "processor s |"]))
    print("|---" * (len(ERRORS) + 5) + "|")
    rows: dict[str, dict[str, object]] = {}
    for count in landmarks:
        used = time.process_time()
        model = Manifold.fit(library, BlendSettings(latent_dim=latent_dim, landmarks=count or None))
        used = time.process_time() - used
        assert model.left_out is not None
        calibration = model.left_out.reliability()
        holes = []
        for seed in (0, 1, 2):
            interior = Interior(model, seed)
            valleys = [plausibility(model.predict(interior.draw())).highlight_valley for _ in range(PLACES)]
            holes.append(float(np.mean(np.array(valleys) > 0.1)))
        kept = coherence_of(model)
        row: dict[str, object] = {"holes": holes, "cpu_s": used, **kept}
        for name in ERRORS:
            row |= {name: list(calibration[name].true), f"{name}_rank": calibration[name].rank_correlation}
        rows[str(count or "all")] = row
        cells = [
            f"{found.true[0]:.3g} / {found.true[1]:.3g}, {found.rank_correlation:.2f}"
            for found in (calibration[name] for name in ERRORS)
        ]
        detour = " / ".join(f"{value:.2f}" for value in kept["detour"])
        shares = ", ".join(f"{share:.0%}" for share in holes)
        cells += [detour, f"{kept['kept_percent']} %", shares, f"{used:.0f}"]
        print(f"| {count or 'all'} | " + " | ".join(cells) + " |", flush=True)
    return rows


def record(path: Path | None, results: dict[str, object]) -> None:
    """Add results to those of a file."""
    if path is not None:
        before = json.loads(path.read_text()) if path.exists() else {}
        path.write_text(json.dumps(before | results, indent=1) + "\n")


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", default=",".join(map(str, SIZES)))
    parser.add_argument("--steps", default=",".join(STEPS), help="import and embed are needed")
    parser.add_argument("--folder", type=Path, help="where files and libraries are kept; by default nowhere")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--compare", type=Path)
    parser.add_argument("--landmarks", default="0,50")
    parser.add_argument("--latent-dim", type=int, default=2)
    given = parser.parse_args()
    if given.compare:
        counts = [int(count) for count in given.landmarks.split(",")]
        record(given.json, {given.compare.stem: compare(given.compare, counts, given.latent_dim)})
        return
    sizes = [int(size) for size in given.sizes.split(",")]
    with tempfile.TemporaryDirectory() as temporary:
        rows, coherences = run_sizes(sizes, given.folder or Path(temporary), given.steps.split(","))
    print_table(sizes, rows)
    steps = {step: dict(zip(map(str, sizes), runs, strict=True)) for step, runs in rows.items()}
    record(given.json, {"steps": steps, "coherence": coherences})
    if given.figure:
        draw(sizes, rows, given.figure)


if __name__ == "__main__":
    main()
