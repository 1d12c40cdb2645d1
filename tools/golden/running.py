"""One step in a process of the pool."""

from __future__ import annotations

import os
import shutil
import warnings
from pathlib import Path

from golden import inputs, values
from golden.commands import CommandError, command
from golden.comparison import Step
from golden.steps import CALLS, COMMANDS

_WITHOUT_JSON = ("calibrate", "explore", "demo")


def prepare(folder: Path) -> None:
    """Write the inputs of all steps."""
    inputs.prepare(folder)


def run_step(name: str, work: Path) -> tuple[Step, float]:
    """What a step returned and left in its folder, and how many seconds of a core it took."""
    began = _cpu_seconds()
    folder = work / "steps" / name.replace(" ", "-")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for path in (work / "inputs").iterdir():
        (folder / path.name).symlink_to(path)
    os.chdir(folder)
    try:
        if name in CALLS:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                made = values.flat(CALLS[name](work / "inputs"))
        else:
            made = _of_commands(COMMANDS[name]) | values.of_folder(folder)
    except Exception as error:
        return {"failed": values.text_value(f"{type(error).__name__}: {error}")}, _cpu_seconds() - began
    finally:
        os.chdir(work)
        shutil.rmtree(folder, ignore_errors=True)
    return {"numbers": made}, _cpu_seconds() - began


def _of_commands(lines: str) -> values.Numbers:
    """Run commands; the messages of those that fail, and what those without JSON print."""
    made: values.Numbers = {}
    for k, line in enumerate(lines.split(";"), start=1):
        with_json = line.split()[0] not in _WITHOUT_JSON
        try:
            printed = command(line + f" --json result{k}.json" * with_json)
            if not with_json:
                made |= values.of_text(printed, f"printed{k}")
        except CommandError as error:
            made[f"error{k}"] = values.text_value(str(error))
    return made


def _cpu_seconds() -> float:
    """Of this process and of those that it started and that ended."""
    return sum(os.times()[:4])
