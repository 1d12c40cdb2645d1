"""Run benchmarks and keep their figures in benchmarks/results/*.json, from which the documents are filled in.

    python benchmarks/run_all.py [NAMES...] --files FOLDER [--neural FILE]

FOLDER holds the measured RGB files of the RGL database that the documents speak of, FILE the published neural fits to
them (Sztrajman et al. 2021). NAMES are results, by default all. What needs files that are not given is left out.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results"
CHARTED = (
    "nearest", "published", "blend_2", "nonnegative", "nonnegative_angles_2_2",
    "blend_2_angles_2_2",
)  # fmt: skip
HELD_OUT = (
    "nearest", "published", "pca_6_cube_root", "gplvm_2", "gplvm_6",
    "blend_2", "blend_3", "nonnegative",
)  # fmt: skip
COMMANDS = {
    "published": "bench_published.py FILES",
    "held_out": "bench_nonnegative.py FILES --numbers 8 12 24 --anchors principled NEURAL --methods "
    + " ".join(HELD_OUT),
    "chart": "manifold chart --library LIBRARY " + " ".join(f"--only {key}" for key in CHARTED),
    "readings": "bench_readings.py LIBRARY",
    "fit": "bench_fit.py --files FILES --appearance-only",
    "exports": "bench_exports.py --files FILES --targets gltf,openpbr",
    "expected_error": "bench_expected_error.py LIBRARY",
    "interior": "bench_interior.py LIBRARY",
    "walks": "bench_walks.py LIBRARY",
    "page": "bench_page.py MODEL",
    "compact": "bench_compact.py FILES",
    "inspection": "bench_inspection.py --files FILES",
    "photo": "bench_photo.py FILES",
    "lamps": "bench_lamps.py --files FILES --library LIBRARY",
    "stability": "manifold stability",
    "goniometer": "bench_goniometer.py",
    "render": "bench_render.py",
    "evaluation": "bench_evaluation.py",
    "fluorescent": "fluorescent_light.py",
    "gplvm": "bench_gplvm.py",
    "prediction": "bench_prediction.py",
    "scale": "bench_scale.py",
}
"""The command that writes each result; FILES, LIBRARY and MODEL stand for the measured files."""


def main() -> None:
    """Run them one after the other; leave with 1 if one of them failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAMES")
    parser.add_argument("--files", type=Path, help="folder of measured .bsdf files")
    parser.add_argument("--neural", type=Path, help="published neural fits, a folder or a zip file")
    given = parser.parse_args()
    if unknown := set(given.names) - set(COMMANDS):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; expected some of {', '.join(COMMANDS)}")
    manifold = [sys.executable, "-m", "manifold"]
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        places = {"LIBRARY": Path(folder, "library.zarr"), "MODEL": Path(folder, "model.h5")}
        places |= {"FILES": given.files, "NEURAL": given.neural}
        wanted = {name: COMMANDS[name].split() for name in given.names or COMMANDS}
        if given.files and any({"LIBRARY", "MODEL"} & set(words) for words in wanted.values()):
            subprocess.run([*manifold, "import", given.files.resolve()], cwd=folder, check=True)
            subprocess.run([*manifold, "embed"], cwd=folder, check=True)
        RESULTS.mkdir(exist_ok=True)
        for name, (program, *words) in wanted.items():
            needed = {
                "LIBRARY": given.files,
                "MODEL": given.files,
                "FILES": given.files,
                "NEURAL": given.neural,
            }
            if missing := [word for word in words if word in needed and not needed[word]]:
                print(f"== {name}: left out, needs {missing[0]}", flush=True)
                continue
            print(f"== {name}", flush=True)
            command = manifold if program == "manifold" else [sys.executable, str(HERE / program)]
            resolved = [str(places[word].resolve()) if word in places else word for word in words]
            target = RESULTS / f"{name}.json"
            target.unlink(missing_ok=True)
            subprocess.run([*command, *resolved, "--json", str(target)], check=False)
            if (
                not target.exists()
            ):  # a status of 1 may be a finding: `stability` leaves so where a mode is wrong
                failed.append(name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
