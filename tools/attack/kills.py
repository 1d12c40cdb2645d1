"""Commands that write, killed or interrupted at any moment: what they write is old or whole, the next run tidies up.

Not among them are calibrate, compare, demo, fetch, stability and walk.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

from attack import sandbox
from attack.cases import command


def _is_model(path: Path) -> bool:
    from manifold.model.model_file import read_model

    return bool(read_model(path).names)


def _is_bsdf(path: Path) -> bool:
    from manifold.io_rgl import read_bsdf

    return read_bsdf(path).spectra.size > 0


def _are_bsdfs(path: Path) -> bool:
    return all(_is_bsdf(file) for file in path.glob("[!.]*.bsdf"))


def _is_library(path: Path) -> bool:
    from manifold.library.store import Library

    return not Library.open(path).verify()


def _is_json(path: Path) -> bool:
    return bool(json.loads(path.read_text()))


def _is_picture(path: Path) -> bool:
    return path.read_bytes().endswith(b"IEND\xaeB`\x82")


def _is_page(path: Path) -> bool:
    return path.read_bytes().rstrip().endswith(b"</html>")


def _is_asset(path: Path) -> bool:
    return int.from_bytes(path.read_bytes()[8:12], "little") == path.stat().st_size  # as its header says


def _is_merl(path: Path) -> bool:
    from manifold.formats import registry

    return bool(registry.read_all(path))


def _are_workbooks(path: Path) -> bool:
    from manifold.formats import registry

    return all(registry.read_all(file) for file in path.glob("[!.]*.xlsx"))


def _is_scene(path: Path) -> bool:
    scene = path / "felt.xml"  # last, when all that it names is there
    if not scene.exists():
        return True
    named = [
        one.get("value", "")
        for one in ElementTree.parse(scene).iter("string")
        if one.get("name") == "filename"
    ]
    return all((path / name).is_file() for name in named)


Check = Callable[[Path], bool]
FELT = "files/syn_felt_green_rgb.bsdf"
COMMANDS: tuple[tuple[tuple[str, ...], str, Check], ...] = (
    (("corpus", "made"), "made", _are_bsdfs),
    (("corpus", "measured", "--instrument", "ma-t12"), "measured", _are_workbooks),
    (("import", "files", "--library", "new.zarr"), "new.zarr", _is_library),
    (("embed", "--kind", "material", "--model", "new.h5"), "new.h5", _is_model),
    (("predict", "--latent", "0,0", "--resolution", "8", "-o", "p_rgb.bsdf"), "p_rgb.bsdf", _is_bsdf),
    (("reconstruct", FELT, "-o", "r_rgb.bsdf"), "r_rgb.bsdf", _is_bsdf),
    (("info", "library.zarr", "--json", "info.json"), "info.json", _is_json),
    (("locate", FELT, "--json", "latent.json"), "latent.json", _is_json),
    (("complete", "--suggest", "2", "--json", "next.json"), "next.json", _is_json),
    (("chart", "--only", "nearest", "--json", "chart.json"), "chart.json", _is_json),
    (("report", "--json", "report.json"), "report.json", _is_json),
    (("slices", FELT, "-o", "slices.png"), "slices.png", _is_picture),
    (("map", "-o", "map.png"), "map.png", _is_picture),
    (("render", FELT, "--size", "32", "-o", "ball.png"), "ball.png", _is_picture),
    (("explore", "--html", "map.html"), "map.html", _is_page),
    (("fit", FELT, "-o", "felt.fit.json"), "felt.fit.json", _is_json),
    (("export", "--latent", "0,0", "-o", "there.glb"), "there.glb", _is_asset),
    (("convert", FELT, "-o", "felt.binary"), "felt.binary", _is_merl),
    (("budget", "--example", "felt", "-o", "lean"), "lean", _is_scene),
)


def attack(base: Path, folder: Path, kills: int, interrupts: int, rng: random.Random, log: Path) -> list[str]:
    """Kill and interrupt commands, so many times in all; what went wrong."""
    problems = []
    signals = [signal.SIGKILL] * kills + [signal.SIGINT] * interrupts
    rng.shuffle(signals)
    for number, (arguments, output, check) in enumerate(COMMANDS):
        work = folder / f"kills{number}"
        shutil.copytree(base / "whole", work)
        length = sandbox.run(command(*arguments), work, log).waited
        for k, sent in enumerate(signals[number :: len(COMMANDS)]):
            if rng.random() < 0.5:
                path = work / output
                with suppress(OSError):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
            after = rng.uniform(0.0, 1.1 * length)
            if sent == signal.SIGINT:
                what = f"interruption {k} of {arguments[0]}"
                ended = sandbox.run(_interrupted(command(*arguments), after), work, log)
                if ended.status not in (0, 130) or "Traceback" in ended.err:
                    problems.append(f"{what}: status {ended.status}: {ended.err.strip()[-200:]}")
            else:
                what = f"kill {k} of {arguments[0]}"
                pid = sandbox.start(command(*arguments), work, log)
                time.sleep(after)
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
            try:
                if (work / output).exists() and not check(work / output):
                    problems.append(f"{what}: half of {output}")
            except Exception as error:
                problems.append(f"{what}: {output}: {error}")
        ended = sandbox.run(command(*arguments), work, log)
        if ended.status != 0:
            problems.append(f"{arguments[0]} after kills: {ended.err.strip()[:200]}")
        left = [path.name for path in work.iterdir() if path.name.startswith(".")]
        if left:
            problems.append(f"{arguments[0]}: left {', '.join(left)}")
    return problems


def _interrupted(task: Callable[[], object], after: float) -> Callable[[], object]:
    """A task with Ctrl-C some seconds after it began."""

    def call() -> None:
        timer = threading.Timer(after, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        try:
            task()
        finally:
            timer.cancel()

    return call
