"""How many files and functions of the package one command enters: what a reader has to follow.

    python benchmarks/count_calls.py predict --latent 0.5,0.5

Runs `manifold` with these arguments in this process under a profile; counts functions of `manifold` and `cli` that were
called at least once, modules being imported left out, their files, and the calls that went from one file to another.
"""

from __future__ import annotations

import inspect
import sys
import threading
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]
ROOTS = (str(PACKAGE / "manifold") + "/", str(PACKAGE / "cli") + "/")


def _is_function(code: CodeType) -> bool:
    """Whether it is a function with a name: no module, class body, lambda or comprehension."""
    return bool(code.co_flags & inspect.CO_OPTIMIZED) and not code.co_name.startswith("<")


def main(arguments: list[str]) -> None:
    """Run the command and print the counts."""
    from manifold.cli.main import run

    entered: Counter[CodeType] = Counter()
    crossings = 0

    def profile(frame: FrameType, event: str, _: Any) -> None:
        nonlocal crossings
        code, caller = frame.f_code, frame.f_back
        if event != "call" or not _is_function(code) or not code.co_filename.startswith(ROOTS):
            return
        if (
            caller is not None
            and not _is_function(caller.f_code)
            and "<module>" in (caller.f_code.co_name, getattr(caller.f_back, "f_code", code).co_name)
        ):
            return  # what a module or class calls while it is imported
        entered[code] += 1
        if caller is not None and caller.f_code.co_filename.startswith(ROOTS):
            crossings += caller.f_code.co_filename != code.co_filename

    threading.setprofile(profile)
    sys.setprofile(profile)
    try:
        run(arguments)
    except SystemExit as end:
        status = end.code
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    files = Counter(code.co_filename for code in entered)
    print(
        f"{len(files)} files, {len(entered)} functions, {crossings} calls between files; exit status {status or 0}"
    )
    for name, count in sorted(files.items()):
        print(f"{count:5d} {Path(name).relative_to(PACKAGE)}")


if __name__ == "__main__":
    main(sys.argv[1:])
