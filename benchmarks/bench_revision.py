"""How long commands take now, as a multiple of what they took at an earlier revision.

    python benchmarks/bench_revision.py REVISION [--rounds 9] [--files FOLDER] [--json FILE]

Both revisions are installed into folders of their own, share the other packages, and take turns: starting, importing
the RGB files of `manifold corpus` (or of a folder) into a new library, and predicting from a model of them.
Medians of whole commands are compared; `sync` before each, not after it.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
START = "import sys; from manifold.cli.main import run; sys.argv[0] = 'manifold'; sys.exit(run())"


def install(revision: str | None, folder: Path) -> Path:
    """Install a revision (None: the working tree) without its requirements; the folder that holds it."""
    if revision is None:
        names = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT,
            check=True,
            capture_output=True,
        )
        command, listed = ["tar", "-c", "--null", "--files-from", "-"], names.stdout
    else:
        command, listed = ["git", "archive", revision], b""
    archive = subprocess.run(command, cwd=ROOT, input=listed, check=True, capture_output=True)
    source, target = folder / "source", folder / "installed"
    source.mkdir(parents=True)
    subprocess.run(["tar", "-x", "-C", source], input=archive.stdout, check=True)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-compile", "--target", target]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, source], check=True)
    return target


def seconds(installed: Path, folder: Path, *arguments: object) -> float:
    """Seconds that a command of an installed revision takes in a folder."""
    os.sync()
    environment = os.environ | {"PYTHONPATH": str(installed)}
    command = [sys.executable, "-c", START, *map(str, arguments)]
    begin = time.perf_counter()
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    return time.perf_counter() - begin


def one_round(installed: Path, folder: Path, files: Path) -> dict[str, float]:
    """Seconds of every command, once. The model is made in the first round."""
    shutil.rmtree(folder / "new.zarr", ignore_errors=True)
    result = {
        "--version": seconds(installed, folder, "--version"),
        "predict --help": seconds(installed, folder, "predict", "--help"),
        "import": seconds(installed, folder, "import", files, "-L", "new.zarr"),
    }
    if not (folder / "model.h5").exists():
        shutil.copytree(folder / "new.zarr", folder / "library.zarr")
        seconds(installed, folder, "embed", "-L", "library.zarr")
    (folder / "predicted_rgb.bsdf").unlink(missing_ok=True)
    prediction = ("predict", "--latent", "0.1,0.2", "-o", "predicted_rgb.bsdf")
    return result | {"predict": seconds(installed, folder, *prediction)}


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("revision", help="the earlier revision, as git names it")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--files", type=Path, help="folder of RGB .bsdf files (default: those of `corpus`)")
    parser.add_argument("--json", type=Path, help="write the result here")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        folders = {name: Path(work) / name for name in ("before", "now")}
        installed = {
            name: install(arguments.revision if name == "before" else None, folder)
            for name, folder in folders.items()
        }
        files = arguments.files
        if files is None:
            files = Path(work) / "corpus"
            seconds(installed["now"], Path(work), "corpus", "--rgb", files)
        taken: dict[str, dict[str, list[float]]] = {}
        for number in range(arguments.rounds + 1):
            for name in random.sample(list(folders), len(folders)):
                for command, value in one_round(installed[name], folders[name], files.resolve()).items():
                    if number:  # The first round compiles and warms up.
                        taken.setdefault(command, {}).setdefault(name, []).append(value)
    medians = {
        command: {name: statistics.median(values) for name, values in sides.items()}
        for command, sides in taken.items()
    }
    for command, sides in medians.items():
        ratio = sides["now"] / sides["before"]
        print(f"{command:15} {sides['now']:.3f} s now, {sides['before']:.3f} s before: {ratio:.2f} times")
    if arguments.json:
        arguments.json.write_text(json.dumps({"revision": arguments.revision, "seconds": medians}) + "\n")


if __name__ == "__main__":
    main()
