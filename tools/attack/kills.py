"""Commands that write, killed at any moment: what they write is old or whole, and the next run works."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from attack import sandbox
from attack.cases import command


def _is_model(path: Path) -> bool:
    from manifold.model.model_file import read_model

    return bool(read_model(path).names)


def _is_bsdf(path: Path) -> bool:
    from manifold.io_rgl import read_bsdf

    return read_bsdf(path).spectra.size > 0


def _is_library(path: Path) -> bool:
    from manifold.library.store import Library

    return not Library(path).verify()


def _is_json(path: Path) -> bool:
    return bool(json.loads(path.read_text()))


def _is_picture(path: Path) -> bool:
    return path.read_bytes().endswith(b"IEND\xaeB`\x82")


FELT = "files/syn_felt_green_rgb.bsdf"
COMMANDS: tuple[tuple[tuple[str, ...], str, Callable[[Path], bool]], ...] = (
    (("import", "files", "--library", "new.zarr"), "new.zarr", _is_library),
    (("embed", "--kind", "gplvm", "--model", "new.h5"), "new.h5", _is_model),
    (("predict", "--latent", "0,0", "--resolution", "8", "-o", "p_rgb.bsdf"), "p_rgb.bsdf", _is_bsdf),
    (("info", "library.zarr", "--json", "info.json"), "info.json", _is_json),
    (("map", "-o", "map.png"), "map.png", _is_picture),
)


def attack(base: Path, folder: Path, kills: int, rng: random.Random, log: Path) -> list[str]:
    """Kill commands, so many times in all; what went wrong."""
    problems = []
    for number, (arguments, output, check) in enumerate(COMMANDS):
        work = folder / f"kills{number}"
        shutil.copytree(base / "whole", work)
        length = sandbox.run(command(*arguments), work, log).waited
        for k in range(number, kills, len(COMMANDS)):
            path, what = work / output, f"kill {k} of {arguments[0]}"
            if rng.random() < 0.5:
                with suppress(OSError):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
            pid = sandbox.start(command(*arguments), work, log)
            time.sleep(rng.uniform(0.0, 1.1 * length))
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            try:
                if path.exists() and not check(path):
                    problems.append(f"{what}: half of {output}")
            except Exception as error:
                problems.append(f"{what}: {output}: {error}")
        ended = sandbox.run(command(*arguments), work, log)
        if ended.status != 0:
            problems.append(f"{arguments[0]} after kills: {ended.err.strip()[:200]}")
    return problems
