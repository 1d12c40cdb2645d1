"""Processor seconds of commands on measured RGB files, one thread each: those that take more than five are kept.

    python benchmarks/bench_commands.py FOLDER [--only WORD] [--json FILE]

FOLDER holds the `.bsdf` files. Run the commands once before.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from left_out import write_ma_t12

import manifold as mf

LEAST = 5.0  # processor seconds of what is kept
NAME = "cardboard"
COMMANDS = {
    "import": "import rgl",
    "embed": "embed",
    "predict": "predict 0.1,0.2 -o predicted_rgb.bsdf",
    "predict_attributes": "predict cardboard --gloss 60=40 -o attributes_rgb.bsdf",
    "locate": "locate rgl/cardboard_rgb.bsdf",
    "reconstruct": "reconstruct rgl/cardboard_rgb.bsdf -o reconstructed_rgb.bsdf",
    "complete": "complete readings.csv --unit brdf -o completed_rgb.bsdf",
    "complete_lab": "complete --lab 40,50,30 --gloss 60=70 -o coat_rgb.bsdf",
    "complete_photo": "photograph ball.png --light studio -o photo_rgb.bsdf",
    "convert": "convert rgl/cardboard_rgb.bsdf -o cardboard.binary",
    "render": "render cardboard -o ball.png",
    "walk": "walk cardboard paper_blue -o walk.png",
    "slices": "slices cardboard -o slices.png",
    "map": "map -o map.png",
    "explore": "explore -o map.html",
    "fit": "fit rgl/cardboard_rgb.bsdf -o fit.json",
    "export": "export rgl/cardboard_rgb.bsdf -o cardboard.glb",
    "find": "find cardboard",
    "compact": "compact copy.zarr",
    "report": "report",
    "report_compare": "report --compare",
    "chart": "chart -o chart.png",
    "stability": "stability -o stability.png",
}


def seconds_of(arguments: str, folder: Path) -> float:
    """Processor seconds of a command and its children."""
    threads = {"OPENBLAS_NUM_THREADS": "1", "MANIFOLD_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "manifold", *arguments.split()],
        cwd=folder,
        env=os.environ | threads,
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def prepare(folder: Path, files: Path) -> None:
    """The files, and readings of one of them."""
    (folder / "rgl").symlink_to(files.resolve())
    brdf = mf.MeasuredBRDF(mf.read_bsdf(files / f"{NAME}_rgb.bsdf"))
    write_ma_t12(folder / "readings.csv", brdf)


def main() -> None:
    """Time the commands one after the other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        prepare(folder, given.folder)
        for key, arguments in COMMANDS.items():
            if key not in ("import", "embed") and given.only not in key:
                continue
            if key == "compact":
                seconds_of("import rgl --library copy.zarr", folder)
            if key == "complete_photo":
                seconds_of("render cardboard -o ball.png", folder)
            try:
                seconds = seconds_of(arguments, folder)
            except subprocess.CalledProcessError as error:
                print(f"{key}: {error}", flush=True)
                continue
            print(f"{key:20} {seconds:8.1f} s", flush=True)
            if seconds > LEAST:
                found[key] = float(round(seconds)) if seconds >= 10 else seconds
            if given.json is not None:
                document = {"command": "bench_commands.py FOLDER", "cpu_s": found}
                given.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
