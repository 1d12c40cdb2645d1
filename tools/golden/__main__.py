"""Run commands and calls on the corpus and on real files, and compare every number with those that were kept.

    python tools/golden                 all steps, compared with tools/golden/kept.json
    python tools/golden --only report   the steps whose names contain a word; may be repeated
    python tools/golden --keep          what was found is kept from now on

Real files are taken from MANIFOLD_RGL_DIR, else ../shared/rgl/real, and ../shared/files; steps that need some that are
missing are left out. Exit status 1 if a number moved, appeared or disappeared.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import re
import shlex
import shutil
import sys
import tempfile
import time
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tools"), str(REPOSITORY / "tests")]

from golden import running  # noqa: E402
from golden.comparison import Step, compared  # noqa: E402
from golden.steps import CALLS, COMMANDS  # noqa: E402

KEPT = Path(__file__).parent / "kept.json"
_REAL = ("real", "real.zarr", "real.h5", "real-left-out", "shared", "lamp.exr")  # inputs that may be missing
_DIGITS = 8  # of numbers that are kept


def main() -> int:
    """Parse, run, compare or keep."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", default=[], metavar="WORDS")
    parser.add_argument("--keep", action="store_true", help="replace what is kept, of the steps that ran")
    parser.add_argument("--jobs", type=int, default=2, help="processes that share the steps")
    parser.add_argument("--work", type=Path, help="folder whose inputs are used again; by default a new one")
    parser.add_argument("--against", type=Path, default=KEPT, help="file to compare with, or to keep")
    parser.add_argument("--list", action="store_true", help="print the names of the steps")
    options = parser.parse_args()
    names = [n for n in (*COMMANDS, *CALLS) if not options.only or any(word in n for word in options.only)]
    if not names:
        parser.error(f"no step's name contains any of: {', '.join(options.only)}; --list prints all")
    if options.list:
        print("\n".join(names))
        return 0
    work = options.work or Path(tempfile.mkdtemp(prefix="golden-"))
    try:
        return _run(names, work.resolve(), options)
    finally:
        if options.work is None:
            shutil.rmtree(work, ignore_errors=True)


def _run(names: list[str], work: Path, options: argparse.Namespace) -> int:
    inputs = work / "inputs"
    context = multiprocessing.get_context("spawn")
    kept: dict[str, Step] = json.loads(options.against.read_text()) if options.against.is_file() else {}
    found: dict[str, Step] = {}
    moved: list[str] = []
    began = time.monotonic()
    with ProcessPoolExecutor(options.jobs, mp_context=context) as pool:
        if not inputs.is_dir():
            partial = work / "inputs.partial"
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir(parents=True)
            pool.submit(running.prepare, partial).result()
            partial.rename(inputs)
            print(f"inputs: {time.monotonic() - began:.0f} s", flush=True)
        names, left_out = _possible(names, inputs)
        futures: dict[Future[tuple[Step, float]], str] = {
            pool.submit(running.run_step, name, work): name for name in names
        }
        for future in as_completed(futures):
            name = futures[future]
            try:
                found[name], seconds = future.result()
            except Exception as error:  # the process died
                found[name], seconds = {"failed": f"{type(error).__name__}: {error}"}, 0.0
            lines = compared(name, kept[name], found[name]) if name in kept else [_summary(found[name])]
            moved += [name] * bool(lines and name in kept)
            print(
                f"{name} ({seconds:.0f} s): {lines[0] if lines else 'as kept'}",
                *lines[1:],
                sep="\n    ",
                flush=True,
            )
    if left_out:
        print(f"left out, no real files at hand: {', '.join(left_out)}")
    count = sum(len(step.get("numbers", ())) for step in found.values())
    failed = [
        n
        for n, step in found.items()
        if "failed" in step or any(re.fullmatch(r"error\d", v) for v in step["numbers"])
    ]
    print(f"{len(found)} steps, {count} values, in {time.monotonic() - began:.0f} s")
    print(f"failed: {', '.join(failed) or 'none'}\nmoved: {', '.join(moved) or 'none'}")
    if options.keep:
        whole = {name: step for name, step in found.items() if "failed" not in step}
        _keep({n: step for n, step in (kept | whole).items() if n in (*COMMANDS, *CALLS)}, options.against)
    return int(bool(failed) or (bool(moved) and not options.keep))


def _possible(names: list[str], inputs: Path) -> tuple[list[str], list[str]]:
    """The steps whose inputs are at hand, and the others."""
    missing = [name for name in _REAL if not (inputs / name).exists()]

    def lacks(name: str) -> bool:
        words = shlex.split(COMMANDS.get(name, ""), comments=False)
        return any(word.rstrip(";").split("/")[0] in missing for word in words)

    return [n for n in names if not lacks(n)], [n for n in names if lacks(n)]


def _summary(step: Step) -> str:
    return f"failed: {step['failed']}" if "failed" in step else f"new, {len(step['numbers'])} values"


def _keep(steps: dict[str, Step], path: Path) -> None:
    """Write one value a line, so that a difference of two versions can be read."""

    def rounded(step: Step) -> Step:
        if "numbers" not in step:
            return step
        return {
            "numbers": {
                key: value if isinstance(value, str) else float(f"{value:.{_DIGITS}g}")
                for key, value in sorted(step["numbers"].items())
            }
        }

    text = json.dumps({name: rounded(steps[name]) for name in sorted(steps)}, indent=0, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
    print(f"kept {path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    sys.exit(main())
