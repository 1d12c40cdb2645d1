"""What every target of exports loses: the table of docs/explanation/fits.md, CIEDE2000 on the ball, --mapped / default.

    python benchmarks/bench_exports.py --files FOLDER [--targets gltf,openpbr] [--work FOLDER] [--json FILE]

FOLDER holds .bsdf files, which are fitted, and their fits, if there are any. What was exported to the folder --work
before is kept.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from pathlib import Path

from manifold.fit.exporting import export_all
from manifold.fit.exports import TARGETS

TABLE = ("gltf", "openpbr", "standard-surface", "usd", "blender", "unreal", "unity")
SUMMARIES = {"median": statistics.median, "mean": statistics.mean, "largest": max}


def losses(files: Path, target: str, work: Path, *, is_mapped: bool) -> dict[str, dict[str, float]]:
    """CIEDE2000 of a target and of `principled`, by material."""
    outcomes = export_all(files, TARGETS[target], work / f"{target}_{is_mapped}", is_mapped=is_mapped)
    made = {outcome.name: outcome.content or {} for outcome in outcomes}
    return {
        name: {"own": e["ciede2000"], "principled": e["principled_ciede2000"]} for name, e in made.items()
    }


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=Path, required=True)
    parser.add_argument("--targets", default=",".join(TABLE))
    parser.add_argument("--work", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    targets = options.targets.split(",")
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
