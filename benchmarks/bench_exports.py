"""What every target of exports loses: the table of docs/explanation/fits.md, CIEDE2000 on the ball, --mapped / default.

    python benchmarks/bench_exports.py --files FOLDER [--targets gltf,openpbr] [--work FOLDER] [--json FILE]
    python benchmarks/bench_exports.py --files FOLDER --in-lights EXPORTED ... [--targets gltf,openpbr] [--json FILE]

FOLDER holds .bsdf files, which are fitted, and their fits, if there are any. What was exported to the folder --work
before is kept.

--in-lights compares fitted parameters that were exported before, also by other versions, into folders of --work,
evaluated in the formulas of their engines, which tests hold to renders, against the measured files, on the ball in the
studio and under a sun 45 and 80 degrees beside the view, beside the number that was printed.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from pathlib import Path

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import ball_colours
from manifold.colour.ball_colours import VIEW, Ball
from manifold.directions import normalize
from manifold.fit.exporting import export_all
from manifold.fit.exports import TARGETS
from manifold.fit.exports.targets import TargetBRDF
from manifold.io_rgl import material_name, read_bsdf

TABLE = ("gltf", "openpbr", "standard-surface", "usd", "blender", "unreal", "unity")
SUN_PIXELS = 48  # across the ball: a sharp highlight is wider than one
SUMMARIES = {"median": statistics.median, "mean": statistics.mean, "largest": max}


def losses(files: Path, target: str, work: Path, *, is_mapped: bool) -> dict[str, dict[str, float]]:
    """CIEDE2000 of a target and of `principled`, by material."""
    outcomes = export_all(files, TARGETS[target], work / f"{target}_{is_mapped}", is_mapped=is_mapped)
    made = {outcome.name: outcome.content or {} for outcome in outcomes}
    return {
        name: {"own": e["ball"]["unseen_light"], "principled": e["principled_ball"]["unseen_light"]}
        for name, e in made.items()
    }


def sun(degrees: float) -> Ball:
    """The lit pixels of a ball under a distant lamp to the right of the view; a white diffuser that faces it is 1."""
    right = normalize(np.cross([0.0, 0.0, 1.0], VIEW))
    lamp = np.cos(np.deg2rad(degrees)) * VIEW + np.sin(np.deg2rad(degrees)) * right
    across = 2.0 * (np.arange(SUN_PIXELS) + 0.5) / SUN_PIXELS - 1.0
    places = np.stack(np.meshgrid(across, -across), axis=-1).reshape(-1, 2)
    places = places[np.sum(places**2, axis=1) < 1.0]
    up = np.cross(VIEW, right)
    depth = np.sqrt(1.0 - np.sum(places**2, axis=1))
    normals = places @ [right, up] + depth[:, None] * VIEW
    lit = normals @ lamp > 0.0
    tangents = normalize(np.cross(up, normals[lit]))
    frames = np.stack([tangents, np.cross(normals[lit], tangents), normals[lit]], axis=1)
    wi, wo = frames @ VIEW, frames @ lamp
    return Ball(wi, wo, np.pi * wo[:, 2], np.arange(len(wi)), places[lit])


LIGHTS = {"studio": ball_colours.ball(), "sun 45": sun(45.0), "sun 80": sun(80.0)}


def in_lights(files: Path, target: str, exported: Path) -> dict[str, dict[str, float]]:
    """CIEDE2000 that was printed, and in every light, by material, of fits in a folder of `losses`."""
    made = {}
    for line in (exported / f"{target}_False" / "exports.jsonl").read_text(encoding="utf-8").splitlines():
        export = json.loads(line)["result"]
        model = TargetBRDF(TARGETS[target], TARGETS[target].defaults | export["parameters"])
        path = next(p for p in files.rglob("*.bsdf") if material_name(p) == export["material"])
        material = MeasuredBRDF(read_bsdf(path))
        made[export["material"]] = {"printed": export["ball"]["unseen_light"]} | {
            light: ball.difference(
                *(brdf.eval(ball.wi, ball.wo) for brdf in (model, material)), material.bands
            )
            for light, ball in LIGHTS.items()
        }
    return made


def print_in_lights(files: Path, targets: list[str], folders: list[Path], document: Path | None) -> None:
    """Print the tables of `in_lights`, a row for each target and folder."""
    found = {
        folder.name: {target: in_lights(files, target, folder) for target in targets} for folder in folders
    }
    columns = ("printed", *LIGHTS)
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
        found = {
            target: [losses(options.files, target, work, is_mapped=mapped) for mapped in (True, False)]
            for target in targets
        }
    principled = {name: loss["principled"] for name, loss in found[targets[0]][0].items()}
    print("| file | `principled` |", " | ".join(targets), "|")
    print("|---" * (2 + len(targets)) + "|")
    for name, loss in principled.items():
        cells = [" / ".join(f"{made[name]['own']:.2f}" for made in found[target]) for target in targets]
        print(f"| {name} | {loss:.2f} |", " | ".join(cells), "|")
    for word, summary in SUMMARIES.items():
        cells = [
            " / ".join(f"{summary([loss['own'] for loss in made.values()]):.2f}" for made in found[target])
            for target in targets
        ]
        print(
            f"| **{word}** | {summary(principled.values()):.2f} |", " | ".join(f"**{c}**" for c in cells), "|"
        )
    if options.json:
        rows = {"principled": list(principled.values())}
        for target, (mapped, fitted) in found.items():
            rows[f"{target}_mapped"] = [loss["own"] for loss in mapped.values()]
            rows[f"{target}_fitted"] = [loss["own"] for loss in fitted.values()]
        figures = {name: [summary(row) for summary in SUMMARIES.values()] for name, row in rows.items()}
        options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
