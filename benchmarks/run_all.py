"""Run every benchmark, printing as they go, and keep their figures in benchmarks/results/*.json."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
COMMANDS = {
    "evaluation": ["bench_evaluation.py"],
    "import": ["bench_import.py"],
    "goniometer": ["bench_goniometer.py"],
    "prediction": ["bench_prediction.py"],
    "render": ["bench_render.py"],
    "fluorescent": ["fluorescent_light.py"],
    "fit": ["bench_fit.py", "--cases", "20", "--baseline-cases", "3"],
    "gplvm": ["bench_gplvm.py"],
}


def main() -> None:
    """Run them one after the other; leave with 1 if one of them failed."""
    results = HERE / "results"
    results.mkdir(exist_ok=True)
    failed = []
    for name, (script, *options) in COMMANDS.items():
        print(f"== {name}", flush=True)
        target = results / f"{name}.json"
        command = [sys.executable, str(HERE / script), *options, "--json", str(target)]
        if subprocess.run(command, cwd=HERE, check=False).returncode != 0:
            failed.append(name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
