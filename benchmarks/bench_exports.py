"""What every target of exports loses: the table of docs/explanation/fits.md, CIEDE2000 on the ball.

OpenPBR has a column for each program that evaluates it, beside the worst of them.

    python benchmarks/bench_exports.py --files FOLDER [--targets gltf,openpbr] [--work FOLDER] [--json FILE]
    python benchmarks/bench_exports.py --files FOLDER --in-lights EXPORTED ... [--targets gltf,openpbr] [--json FILE]

FOLDER holds .bsdf files, which are fitted, and their fits, if there are any. What was exported to the folder --work
before is kept.

--in-lights compares fitted parameters that were exported before, also by other versions, into folders of --work,
evaluated in the formulas of their engines, which tests hold to renders, against the measured files, on the ball in the
judged lights, beside the number that was printed.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from pathlib import Path

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import panel
from manifold.fit.exporting import export_sources, exports
from manifold.fit.exports.targets import TargetBRDF
from manifold.io_rgl import material_name, read_bsdf
from manifold.many.batch import batch
from manifold.registries import TARGETS

TABLE = ("gltf", "openpbr", "standard-surface", "usd", "blender", "unreal", "unity")
SUMMARIES = {"median": statistics.median, "mean": statistics.mean, "largest": max}


def losses(files: Path, target: str, work: Path) -> dict[str, dict[str, float]]:
    """CIEDE2000 of a target and of `principled`, by material."""
    made = batch(exports(TARGETS[target]), export_sources(files), work / target)
    made = {outcome.name: outcome.content or {} for outcome in made.outcomes}
    return {
        name: {"own": e["errors"]["ball"], "principled": e["principled_errors"]["ball"]}
        | {program: errors["ball"] for program, errors in e.get("implementations", {}).items()}
        for name, e in made.items()
    }


def in_lights(files: Path, target: str, exported: Path) -> dict[str, dict[str, float]]:
    """CIEDE2000 that was printed, and in every light, by material, of fits in a folder of `losses`."""
    made, lights = {}, panel.judged()
    for line in (exported / target / "exports.jsonl").read_text(encoding="utf-8").splitlines():
        export = json.loads(line)["result"]
        programs = export.get("implementations", {})
        worst = max(programs, key=lambda program: programs[program]["ball"], default=None)
        model = TargetBRDF(TARGETS[target], TARGETS[target].defaults | export["parameters"], worst)
        path = next(p for p in files.rglob("*.bsdf") if material_name(p) == export["material"])
        material = MeasuredBRDF(read_bsdf(path))
        own, truth = (np.maximum(brdf.eval(lights.wi, lights.wo), 0.0) for brdf in (model, material))
        printed = export["errors"]["ball"]
        made[export["material"]] = {"printed": printed} | lights.errors(own, truth, material.bands).lights
    return made


def print_in_lights(files: Path, targets: list[str], folders: list[Path], document: Path | None) -> None:
    """Print the tables of `in_lights`, a row for each target and folder."""
    found = {
        folder.name: {target: in_lights(files, target, folder) for target in targets} for folder in folders
    }
    columns = ("printed", *panel.JUDGED)
    print("| target | exported |", " | ".join(columns), "|")
    print("|---" * (2 + len(columns)) + "|")
    for target in targets:
        for folder, made in found.items():
            each = [[loss[column] for loss in made[target].values()] for column in columns]
            cells = [f"{statistics.median(losses):.2f} / {max(losses):.2f}" for losses in each]
            print(f"| {target} | {folder} |", " | ".join(cells), "|")
    if document:
        document.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=Path, required=True)
    parser.add_argument("--targets", default=",".join(TABLE))
    parser.add_argument("--work", type=Path)
    parser.add_argument("--in-lights", type=Path, nargs="+", metavar="EXPORTED")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    targets = options.targets.split(",")
    if options.in_lights:
        print_in_lights(options.files, targets, options.in_lights, options.json)
        return
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        found = {target: losses(options.files, target, work) for target in targets}
    principled = {name: loss["principled"] for name, loss in found[targets[0]].items()}
    columns = {target: (target, "own") for target in targets}
    columns |= {f"{t} in {i}": (t, i) for t in targets for i in TARGETS[t].implementations}
    print("| file | `principled` |", " | ".join(columns), "|")
    print("|---" * (2 + len(columns)) + "|")
    for name, loss in principled.items():
        cells = [f"{found[target][name][program]:.2f}" for target, program in columns.values()]
        print(f"| {name} | {loss:.2f} |", " | ".join(cells), "|")
    for word, summary in SUMMARIES.items():
        cells = [f"{summary([loss[i] for loss in found[t].values()]):.2f}" for t, i in columns.values()]
        print(
            f"| **{word}** | {summary(principled.values()):.2f} |", " | ".join(f"**{c}**" for c in cells), "|"
        )
    if options.json:
        rows = {"principled": list(principled.values())}
        for title, (target, program) in columns.items():
            key = title.replace(" in ", "_fitted_") if program != "own" else f"{target}_fitted"
            rows[key] = [loss[program] for loss in found[target].values()]
        figures = {name: [summary(row) for summary in SUMMARIES.values()] for name, row in rows.items()}
        options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
