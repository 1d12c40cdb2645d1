"""Attack the package with changed inputs, for some minutes: `make attack`, or `python tools/attack --minutes 10`.

Every case runs in a process of its own, with 10 s of a core and 2 GB. Reported are tracebacks, crashes, hangs, too much
memory, and what is silently wrong; then the exit status is 1. A seed makes the same cases; `--only` repeats one.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tools"), str(REPOSITORY / "tests")]
os.environ["MANIFOLD_RENDERER"] = "scalar"

from attack import kills, sandbox  # noqa: E402
from attack.cases import KINDS, prepare  # noqa: E402


def main() -> int:
    """Parse, prepare, attack, report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--kinds", default=",".join(KINDS), help="some of " + ", ".join(KINDS))
    parser.add_argument(
        "--flips", type=int, default=0, help="single-bit flips of a model, all checked in one process"
    )
    parser.add_argument("--kills", type=int, default=0, help="SIGKILLs over commands that write")
    parser.add_argument("--only", help="one case, such as scenes:17")
    options = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="attack-"))
    try:
        return _attack(options, work)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _attack(options: argparse.Namespace, work: Path) -> int:
    base, log = work / "base", work / "log"
    base.mkdir()
    _import_everything()
    pid = os.fork()  # so that no threads begin in this process, which forks for every case
    if pid == 0:
        prepare(base)
        os._exit(0)
    if os.waitpid(pid, 0)[1]:
        raise SystemExit("the inputs could not be made")
    problems: list[str] = []
    if options.flips:
        problems += _flips(base, work, options.flips, random.Random(options.seed))
    if options.kills:
        found = kills.attack(base, work, options.kills, random.Random(options.seed), log)
        print(f"kills: {options.kills}, {len(found)} problems")
        problems += found
    counts: Counter[str] = Counter()
    until = time.monotonic() + 60.0 * options.minutes
    one = options.only.split(":") if options.only else None
    number = int(one[1]) if one else 0
    while time.monotonic() < until:
        for kind in [one[0]] if one else options.kinds.split(","):
            problem = _case(kind, number, options.seed, base, work, log)
            counts[kind] += 1
            if problem:
                problems.append(problem)
                print(problem, flush=True)
        number += 1
        if one:
            break
    print(", ".join(f"{kind}: {count}" for kind, count in counts.items()) or "no cases")
    print(f"{len(problems)} problems (seed {options.seed})")
    for problem in problems:
        print(f"  {problem}")
    return int(bool(problems))


def _case(kind: str, number: int, seed: int, base: Path, work: Path, log: Path) -> str | None:
    """Do one case; what went wrong in it."""
    folder = work / "case"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    case = KINDS[kind](base, folder, random.Random(f"{seed} {kind} {number}"))
    ended = sandbox.run(case.task, folder, log)
    problem = ended.problem or case.judge(ended)
    return f"{kind}:{number} ({case.title}): {problem}" if problem else None


def _flips(base: Path, work: Path, count: int, rng: random.Random) -> list[str]:
    """Single bits of a model turned over, each checked by reading it."""
    from manifold.core.errors import ModelError
    from manifold.model.model_file import read_model

    whole = (base / "whole" / "model.h5").read_bytes()
    path, silent, slowest, other = work / "flipped.h5", 0, 0.0, []
    bits = rng.sample(range(8 * len(whole)), min(count, 8 * len(whole)))
    for bit in bits:
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        began = time.monotonic()
        try:
            read_model(path)
            silent += 1
        except ModelError:
            pass
        except Exception as error:
            other.append(f"flip of bit {bit}: {type(error).__name__}: {error}")
        slowest = max(slowest, time.monotonic() - began)
    print(
        f"flips: {len(bits)} of {8 * len(whole)} bits: {silent} silent, {len(other)} crashed, {slowest:.3f} s at most"
    )
    return other + [f"{silent} silent flips"] * bool(silent)


def _import_everything() -> None:
    """What tasks use, so that a fork begins at once."""
    import helpers.small_library  # noqa: F401

    from manifold.cli import main  # noqa: F401


if __name__ == "__main__":
    sys.exit(main())
