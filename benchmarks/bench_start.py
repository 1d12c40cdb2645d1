"""Processor time of helps and of a prediction, as ratios to the imports that they cannot do without.

    python benchmarks/bench_start.py [FOLDER ...] [--times N]

Every FOLDER has a `model.h5` and its library. Commands alternate, and medians count; modules are compiled beforehand.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from manifold.cli.application import COMMANDS

HELP, PREDICT = "import typer", "import numpy, scipy.linalg, h5py, zarr"


def seconds_of(words: Sequence[str], folder: Path) -> float:
    """Processor seconds, user and system, of one run of Python."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *words],
        cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def compare(imports: str, commands: Mapping[str, Sequence[str]], folder: Path, times: int) -> None:
    """Print seconds of each command, and their ratio to those of the imports."""
    runs = {imports: ["-c", imports]} | {
        title: ["-m", "manifold", *words] for title, words in commands.items()
    }
    seconds: dict[str, list[float]] = {title: [] for title in runs}
    for turn in range(times + 1):
        for title, words in runs.items():
            found = seconds_of(words, folder)
            if turn:  # the first one compiles
                seconds[title].append(found)
    least = statistics.median(seconds[imports])
    for title, each in seconds.items():
        median = statistics.median(each)
        print(f"{title:44} {median:6.3f} s {median / least:6.2f}", flush=True)


def main() -> None:
    """Measure the helps, then a prediction in each folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--times", type=int, default=7)
    given = parser.parse_args()
    helps = {"--help": ["--help"]} | {f"{name} --help": [name, "--help"] for name in COMMANDS}
    compare(HELP, helps, Path(), given.times)
    with tempfile.TemporaryDirectory() as folder:
        output = str(Path(folder) / "predicted.bsdf")
        for each in given.folders:
            predict = {f"predict in {each.name}": ["predict", "0.1,0.2", "-o", output]}
            compare(PREDICT, predict, each.resolve(), given.times)


if __name__ == "__main__":
    main()
