"""A Dask cluster of four local workers: results when workers and the scheduler are killed, and speed of two workers.

    python benchmarks/bench_cluster.py [--materials 500] [--fits 40] [--completions 100] [--kills 10] [--json FILE]

Commands import generated RGB files, embed them, fit some and complete readings of simulated MA-T12s: first by two local
processes, then by the cluster, of which workers are killed at random moments and the scheduler is killed and started
again once. A command that ends with an error is run again. Files of both are compared.

Then fits and completions by one worker and by two take turns. Ratios hold for the cores that are free meanwhile: the
load of the machine is written down.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from bench_scale import write_materials

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.analytic.virtual_instruments import MA_T12_BANDS, write_ma_t12
from manifold.core import cluster as dask
from manifold.estimate.inputs import find_inputs, find_samples
from manifold.estimate.sources import FileSource
from manifold.fit import fits
from manifold.many import commands as many
from manifold.many.batch import batch
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions

WORKERS = 4
IN_LIBRARY = 50  # materials that readings are completed from
RUNS = 6  # of a command at most, where it fails
ENVIRONMENT = os.environ | {
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "20",
    "DASK_LOGGING__DISTRIBUTED": "error",
}


def write_readings(folder: Path, count: int) -> None:
    """Workbooks of plastics of random roughness and colour."""
    folder.mkdir(exist_ok=True)
    nm = np.array(MA_T12_BANDS.wavelengths_nm)
    for k in range(count):
        rng = np.random.default_rng([1, k])
        colour = 0.05 + 0.7 * rng.random() * np.exp(
            -(((nm - rng.uniform(420, 680)) / rng.uniform(40, 200)) ** 2)
        )
        alpha = float(np.exp(rng.uniform(np.log(0.06), np.log(0.6))))
        brdf = Plastic(GGX.isotropic(alpha), np.full(len(nm), 1.5), colour, MA_T12_BANDS)
        write_ma_t12(folder / f"sample_{k:03d}.xlsx", brdf, f"sample_{k:03d}", rng)


@dataclass
class LocalCluster:
    """Processes of a scheduler and of its workers, and the largest memory that each has taken, in bytes."""

    workers: int
    folder: Path
    port: int
    scheduler: subprocess.Popen[bytes] | None = None
    nannies: list[subprocess.Popen[bytes]] = field(default_factory=list)
    memory: dict[str, int] = field(default_factory=lambda: {"scheduler": 0, "worker": 0})

    @property
    def address(self) -> str:
        """Of the scheduler."""
        return f"tcp://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start a scheduler, and workers."""
        self.scheduler = self._dask("scheduler", "--host", "127.0.0.1", "--port", str(self.port))
        self.keep_up()

    def keep_up(self) -> None:
        """Start workers in place of those that have ended, as a batch system does: one killed while it starts does."""
        self.nannies = [nanny for nanny in self.nannies if nanny.poll() is None]
        while len(self.nannies) < self.workers:
            words = ["--nthreads", "1", "--memory-limit", "0", "--local-directory", str(self.folder)]
            self.nannies.append(self._dask("worker", self.address, *words))

    def _dask(self, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *words, "--no-dashboard"]
        return subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=ENVIRONMENT
        )

    def stop(self) -> None:
        """End all of them."""
        for process in (*self.nannies, *filter(None, [self.scheduler])):
            with suppress(psutil.NoSuchProcess):
                for child in psutil.Process(process.pid).children(recursive=True):
                    with suppress(psutil.NoSuchProcess):
                        child.kill()
            process.kill()
            process.wait()

    def worker_processes(self) -> list[psutil.Process]:
        """Those that run tasks."""
        found = []
        for nanny in self.nannies:
            with suppress(psutil.NoSuchProcess):
                children = psutil.Process(nanny.pid).children()
                found += [child for child in children if "spawn_main" in " ".join(child.cmdline())]
        return found

    def measure(self) -> None:
        """Note what memory is taken now."""
        assert self.scheduler is not None
        with suppress(psutil.NoSuchProcess):
            now = psutil.Process(self.scheduler.pid).memory_info().rss
            self.memory["scheduler"] = max(self.memory["scheduler"], now)
            for worker in self.worker_processes():
                self.memory["worker"] = max(self.memory["worker"], worker.memory_info().rss)


@contextmanager
def disturbed(
    cluster: LocalCluster, kills: int, span_s: float, step: list[str]
) -> Iterator[list[dict[str, Any]]]:
    """Kill a worker at so many random moments of a span, and the scheduler, once, in its middle; what was done."""
    rng, done, over = random.Random(0), [], threading.Event()
    moments = sorted(
        [(rng.uniform(0.0, span_s), "worker") for _ in range(kills)] + [(0.5 * span_s, "scheduler")]
    )
    start = time.monotonic()

    def disturb() -> None:
        while not over.wait(0.3):
            cluster.measure()
            cluster.keep_up()
            if not moments or time.monotonic() - start < moments[0][0]:
                continue
            _, whom = moments[0]
            if whom == "scheduler":
                cluster.stop()
                cluster.start()
            else:
                found = cluster.worker_processes()
                if not found:
                    continue
                with suppress(psutil.NoSuchProcess):
                    rng.choice(found).send_signal(signal.SIGKILL)
            moments.pop(0)
            done.append({"what": whom, "at_s": round(time.monotonic() - start, 1), "during": step[-1]})

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        yield done
    finally:
        over.set()
        thread.join()


def commands(inputs: Path, folder: Path, counts: argparse.Namespace) -> dict[str, list[str]]:
    """What is run, by its name; with arguments that do not say by whom."""
    files = sorted(str(path) for path in (inputs / "files").iterdir())
    library, model, small = folder / "library.zarr", folder / "model.h5", inputs / "small.zarr"
    return {
        "import": ["import", str(inputs / "files"), "-L", str(library)],
        "embed": ["embed", "-L", str(library if counts.embed == "all" else small), "-M", str(model)],
        "fit": [
            "fit",
            *files[:: max(len(files) // counts.fits, 1)][: counts.fits],
            "-o",
            str(folder / "fits"),
        ],
        "complete": [
            "complete",
            str(inputs / "readings"),
            "-L",
            str(small),
            "-o",
            str(folder / "completions"),
        ],
    }


def run(words: list[str]) -> list[str]:
    """Run a command until it is done; the errors on the way."""
    errors = []
    for _ in range(RUNS):
        ended = subprocess.run(
            [sys.executable, "-m", "manifold", *words], capture_output=True, text=True, check=False
        )
        if ended.returncode == 0:
            return errors
        errors.append(ended.stderr.strip().splitlines()[-1])
        print("  run again:", errors[-1], flush=True)
        time.sleep(3.0)
    sys.exit(f"failed {RUNS} times: {errors[-1]}")


def differences(a: Path, b: Path) -> dict[str, Any]:
    """How results of two folders differ: numbers of files, and of those that are not the same, byte by byte."""

    def contents(folder: Path, pattern: str) -> dict[str, bytes]:
        found = {str(path.relative_to(folder)): path for path in folder.rglob(pattern) if path.is_file()}
        return {name: path.read_bytes() for name, path in found.items()}

    def fitted(folder: Path) -> dict[str, Any]:
        return {
            path.name: {k: v for k, v in json.loads(path.read_text()).items() if k not in ("date", "seconds", "sha256")}
            for path in (folder / "fits").glob("*.fit.json")
        }  # fmt: skip

    def counted(x: dict[str, Any], y: dict[str, Any]) -> dict[str, int]:
        return {"files": len(x), "different": sum(x.get(name) != y.get(name) for name in x.keys() | y.keys())}

    models = [Manifold.load(folder / "model.h5") for folder in (a, b)]
    left_out = [model.left_out.arrays for model in models if model.left_out is not None]
    apart = [float(np.abs(models[0].X - models[1].X).max())]
    apart += [float(np.abs(values - left_out[1][name]).max()) for name, values in left_out[0].items()]
    materials = "library.zarr/materials"
    return {
        "library": counted(contents(a / materials, "*"), contents(b / materials, "*")),
        "model, largest difference of latents and left-out errors": max(apart),
        "fits, without date, duration and checksum": counted(fitted(a), fitted(b)),
        "completions": counted(contents(a / "completions", "*.bsdf"), contents(b / "completions", "*.bsdf")),
    }


def robustness(inputs: Path, folder: Path, counts: argparse.Namespace) -> dict[str, Any]:
    """The same work undisturbed and disturbed."""
    local, there = folder / "local", folder / "cluster"
    for each in (local, there):
        shutil.rmtree(each, ignore_errors=True)
        each.mkdir(parents=True)
    times: dict[str, dict[str, float]] = {"local": {}, "cluster": {}}
    for name, words in commands(inputs, local, counts).items():
        start = time.monotonic()
        run(words if name == "embed" else [*words, "--workers", "2"])
        times["local"][name] = round(time.monotonic() - start, 1)
        print("local", name, times["local"][name], flush=True)
    span_s = 0.4 * sum(times["local"].values())  # twice as many workers
    cluster, step, errors = LocalCluster(WORKERS, folder / "dask", counts.port), ["start"], {}
    cluster.start()
    try:
        with disturbed(cluster, counts.kills, span_s, step) as done:
            for name, words in commands(inputs, there, counts).items():
                step.append(name)
                start = time.monotonic()
                errors[name] = run([*words, "--scheduler", cluster.address])
                times["cluster"][name] = round(time.monotonic() - start, 1)
                print("cluster", name, times["cluster"][name], flush=True)
    finally:
        cluster.stop()
    return {
        "seconds": times,
        "disturbances": done,
        "errors after which a command was run again": errors,
        "differences": differences(local, there),
        "memory_mb": {who: round(size / 1e6) for who, size in cluster.memory.items()},
    }


def speed(inputs: Path, folder: Path, counts: argparse.Namespace) -> dict[str, Any]:
    """Seconds of some fits and completions by one worker and by two, in turns; workers are warm."""
    files = find_inputs([FileSource(path) for path in sorted((inputs / "files").iterdir())[: counts.timed]])
    samples = find_samples([inputs / "readings"])[: 2 * counts.timed]
    seconds: dict[str, dict[int, list[float]]] = {"fits": {1: [], 2: []}, "completions": {1: [], 2: []}}
    for k in range(counts.rounds):
        for count in (1, 2):
            cluster = LocalCluster(count, folder / "dask", counts.port)
            cluster.start()
            try:
                for what, first in (("warm", 4), ("measured", None)):
                    out = folder / f"{what}_{k}_{count}"
                    shutil.rmtree(out, ignore_errors=True)
                    with dask.workers(cluster.address) as workers:
                        start = time.monotonic()
                        batch(fits.fits(fits.FitSettings()), files[:first], out / "a", workers)
                        middle = time.monotonic()
                        command = many.completions_of(inputs / "small.zarr", options=OutputOptions())
                        batch(command, samples[:first], out / "b", workers)
                    if what == "measured":
                        seconds["fits"][count].append(round(middle - start, 2))
                        seconds["completions"][count].append(round(time.monotonic() - middle, 2))
            finally:
                cluster.stop()
        print(seconds, "load", os.getloadavg(), flush=True)
    ratios = {
        name: round(statistics.median(of[1]) / statistics.median(of[2]), 2) for name, of in seconds.items()
    }
    counts = {"fits": len(files), "completions": len(samples)}
    return {"tasks": counts, "seconds": seconds, "ratio of medians": ratios, "load": os.getloadavg()}


def main() -> None:
    """Run what was asked for, and print it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--materials", type=int, default=500)
    parser.add_argument("--embed", choices=("all", "few"), default="all", help=f"few: {IN_LIBRARY} materials")
    parser.add_argument("--fits", type=int, default=40)
    parser.add_argument("--completions", type=int, default=100)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument(
        "--timed", type=int, default=12, help="fits whose time is measured; and twice the completions"
    )
    parser.add_argument("--rounds", type=int, default=3, help="of one worker and two, in turns")
    parser.add_argument("--port", type=int, default=8791)
    parser.add_argument("--only", choices=("robustness", "speed"))
    parser.add_argument("--folder", type=Path, help="where inputs and results are kept; by default nowhere")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (given.folder or Path(temporary)).resolve()
        inputs = folder / "inputs"
        (inputs / "files").mkdir(parents=True, exist_ok=True)
        write_materials(inputs / "files", 0, given.materials)
        write_readings(inputs / "readings", given.completions)
        few = sorted(str(path) for path in (inputs / "files").iterdir())[:IN_LIBRARY]
        run(["import", *few, "-L", str(inputs / "small.zarr")])
        found: dict[str, Any] = {"machine": f"{os.cpu_count()} cores, {platform.machine()}"}
        if given.json is not None and given.json.is_file():
            found = json.loads(given.json.read_text()) | found
        command = {"command": " ".join(["benchmarks/bench_cluster.py", *sys.argv[1:]])}
        if given.only != "speed":
            found["robustness"] = command | robustness(inputs, folder, given)
        if given.only != "robustness":
            found["speed"] = command | speed(inputs, folder, given)
    print(json.dumps(found, indent=1))
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
