"""What is attacked: each kind makes a case in a folder, a task to do there, and a judge of what came out."""

from __future__ import annotations

import json
import os
import random
import shutil
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from attack.mutations import XML_TOKENS, of_archive, of_bytes, of_json, of_text
from attack.sandbox import Ended

Judge = Callable[[Ended], "str | None"]


@dataclass(frozen=True)
class Case:
    """A task, what it must not do beside what no task may, and how it is called in the report."""

    task: Callable[[], object]
    judge: Judge
    title: str


def _anything(ended: Ended) -> str | None:
    return None


def command(*arguments: object) -> Callable[[], object]:
    """A task that runs the command line."""
    from manifold.__main__ import run

    return lambda: run([str(argument) for argument in arguments])


def prepare(base: Path) -> None:
    """Make what is mutated: small files, a library, a model, a fit, scenes, pictures."""
    import numpy as np
    from helpers.instrument_files import write_every_format
    from helpers.sample_files import write_samples
    from helpers.small_library import small_model

    from manifold.fit import fits
    from manifold.library.importing import import_files
    from manifold.render import bsdf_parameters

    (base / "instruments").mkdir()
    write_every_format(base / "instruments")
    write_samples(base / "small", 2)
    import_files(base / "small.zarr", [base / "small"])
    small_model(base / "whole")
    file = next((base / "whole" / "files").glob("*.bsdf"))
    fits.fit(file, base / "a.fit.json", fits.FitSettings(bsdf_parameters.principled(["base_color"])))
    (base / "scene").mkdir()
    shutil.copy(file, base / "scene" / "a_rgb.bsdf")
    (base / "scene" / "s.xml").write_text(
        '<scene version="3.0.0"><default name="what" value="a_rgb"/><path value="."/>\n<integrator type="direct"/>'
        '<sensor type="perspective"><float name="fov" value="45"/><film type="hdrfilm">'
        '<integer name="width" value="16"/>'
        '<integer name="height" value="16"/></film></sensor>\n<include filename="part.xml"/>'
        '<emitter type="constant"/><shape type="sphere"><bsdf type="measured">'
        '<string name="filename" value="$what.bsdf"/></bsdf></shape></scene>'
    )
    (base / "scene" / "part.xml").write_text('<scene version="3.0.0"><bsdf type="diffuse" id="d"/></scene>')
    scene = {
        "type": "scene", "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 16, "height": 16}},
        "ball": {"type": "sphere", "bsdf": {"type": "measured", "filename": "a_rgb.bsdf"}},
        "light": {"type": "constant"},
    }  # fmt: skip
    (base / "scene" / "s.json").write_text(json.dumps(scene))
    (base / "light.txt").write_text(
        "# nm power\n" + "".join(f"{nm} {nm / 500:.3f}\n" for nm in range(400, 701, 20))
    )
    from PIL import Image

    from manifold.render import images

    for suffix in (".png", ".exr"):
        images.write_image(base / f"picture{suffix}", np.linspace(0, 1, 300).reshape(10, 10, 3))
    for suffix in (".jpg", ".tif", ".bmp"):
        Image.open(base / "picture.png").save(base / f"picture{suffix}")


def files(base: Path, folder: Path, rng: random.Random) -> Case:
    """A `.bsdf` of which something is changed: shown, or imported and verified."""
    source = rng.choice(sorted((base / "small").glob("*.bsdf")))
    (folder / source.name).write_bytes(of_bytes(source.read_bytes(), rng))
    if rng.random() < 0.5:
        return Case(command("info", source.name, "--json", "-"), _anything, "info")

    def task() -> None:
        with suppress(SystemExit):
            command("import", source.name)()
        command("info", "library.zarr", "--verify")()

    return Case(task, _anything, "import")


def instruments(base: Path, folder: Path, rng: random.Random) -> Case:
    """A file of an instrument or a simulator of which something is changed: whole where it is read."""
    source = rng.choice(sorted((base / "instruments").iterdir()))
    change = of_archive if source.suffix == ".xlsx" and rng.random() < 0.5 else of_bytes
    (folder / source.name).write_bytes(change(source.read_bytes(), rng))
    return Case(_refusing(lambda: read_whole(folder / source.name)), _anything, source.name)


def read_whole(path: Path) -> None:
    """Read all records of a file; one that is not whole is a RuntimeError."""
    import numpy as np

    from manifold.formats import registry
    from manifold.formats.readings import Readings

    records = registry.read_all(path)
    for record in records:
        parts = [record.wi, record.wo] if isinstance(record, Readings) else []
        if np.any(np.isinf(record.values)) or not all(np.all(np.isfinite(part)) for part in parts):
            raise RuntimeError("a record that is not whole")
    if not records:
        raise RuntimeError("no record, and no error")


def models(base: Path, folder: Path, rng: random.Random) -> Case:
    """A model of which anything is changed: it must be refused."""
    whole = (base / "whole" / "model.h5").read_bytes()
    changed = of_bytes(whole, rng)
    (folder / "m.h5").write_bytes(changed)

    def judge(ended: Ended) -> str | None:
        return "silent: a changed model is read" if ended.status == 0 and changed != whole else None

    return Case(command("info", "m.h5", "-L", base / "whole" / "library.zarr"), judge, "info")


def libraries(base: Path, folder: Path, rng: random.Random) -> Case:
    """A library of which one file is changed, or gone, or something else: what is read of it is right, or refused."""
    shutil.copytree(base / "small.zarr", folder / "l.zarr")
    victim = rng.choice([path for path in sorted((folder / "l.zarr").rglob("*")) if path.is_file()])
    kind = rng.randrange(8)
    if kind == 0:
        victim.unlink()
    elif kind == 1:
        victim.unlink()
        rng.choice((victim.mkdir, lambda: os.mkfifo(victim), lambda: victim.symlink_to("/dev/zero")))()
    elif victim.suffix == ".json" and kind < 6:
        victim.write_text(json.dumps(of_json(json.loads(victim.read_text()), rng)))
    else:
        victim.write_bytes(of_bytes(victim.read_bytes(), rng))

    def task() -> None:
        from manifold.io_rgl import read_bsdf
        from manifold.library.store import Library

        library = Library.open("l.zarr")
        for path in sorted((base / "small").glob("*.bsdf")):
            original = read_bsdf(path)
            if (
                original.name in library
                and library.read(original.name).spectra.tobytes() != original.spectra.tobytes()
            ):
                print("silent: other values", flush=True)
        command("info", "l.zarr", "--verify", "--json", "-")()

    def judge(ended: Ended) -> str | None:
        return "silent: other values" if "silent" in ended.out else None

    return Case(_refusing(task), judge, str(victim.relative_to(folder / "l.zarr")))


def _refusing(task: Callable[[], object]) -> Callable[[], object]:
    """A task whose errors of this package end it as those of the command line do."""

    def run() -> None:
        from manifold.core.errors import ManifoldError

        try:
            task()
        except ManifoldError as error:
            if "\n" in str(error):
                raise RuntimeError("an error of several lines") from error
            raise SystemExit(1) from error

    return run


def scenes(base: Path, folder: Path, rng: random.Random) -> Case:
    """A scene of which something is changed: read, and where it is one, written and loaded by Mitsuba (scalar)."""
    for path in (base / "scene").iterdir():
        (folder / path.name).symlink_to(path)
    name = rng.choice(("s.xml", "s.json", "part.xml"))
    source = base / "scene" / name
    (folder / name).unlink()
    if name == "s.json" and rng.random() < 0.5:
        (folder / name).write_text(json.dumps(of_json(json.loads(source.read_text()), rng)))
    else:
        (folder / name).write_text(of_text(source.read_text(), rng, XML_TOKENS), errors="replace")
    scene = folder / ("s.json" if name == "s.json" else "s.xml")

    def task() -> None:
        from manifold.study.budget.scene_document import SceneDocument

        document = SceneDocument.read(scene)
        _ = document.film_size
        document.write(folder / "out", {})
        if min(document.film_size) <= 512:
            from manifold.render import backend

            mi = backend.mitsuba("rgb")
            document.load(mi, {}, {"type": "hdrfilm", "width": 16, "height": 16})

    return Case(_refusing(task), _anything, name)


def fits(base: Path, folder: Path, rng: random.Random) -> Case:
    """A fit of which an entry or some text is changed: read, and made a BSDF of."""
    text = (base / "a.fit.json").read_text()
    text = json.dumps(of_json(json.loads(text), rng)) if rng.random() < 0.7 else of_text(text, rng)
    (folder / "a.fit.json").write_text(text, errors="replace")

    def task() -> None:
        from manifold.render import fit_json

        fit_json.read(Path("a.fit.json"))

    return Case(_refusing(task), _anything, "read")


def texts(base: Path, folder: Path, rng: random.Random) -> Case:
    """Spectra and pictures of which something is changed."""
    name = rng.choice(
        ("light.txt", *(f"picture{suffix}" for suffix in (".png", ".exr", ".jpg", ".tif", ".bmp")))
    )
    (folder / name).write_bytes(of_bytes((base / name).read_bytes(), rng))

    def task() -> None:
        from manifold.colour.illuminants import Illuminant
        from manifold.render import images

        if name == "light.txt":
            Illuminant.read(folder / name)
        else:
            images.read_image(folder / name)

    return Case(_refusing(task), _anything, name)


ANSWERS = (
    b"HTTP/1.1 200 OK\r\nContent-Length: 7000\r\n\r\n" + bytes(7000),
    b"HTTP/1.1 206 Partial Content\r\nContent-Range: bytes 0-6999/7000\r\nContent-Length: 7000\r\n\r\n"
    + bytes(7000),
    b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/x\r\nContent-Length: 0\r\n\r\n",
    b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n400\r\n" + bytes(1024) + b"\r\n0\r\n\r\n",
    b"HTTP/1.1 503 Busy\r\nRetry-After: 9\r\nContent-Length: 0\r\n\r\n",
    b"HTTP/1.1 100 Continue\r\n\r\n" * 50,
)


def servers(base: Path, folder: Path, rng: random.Random) -> Case:
    """A server that answers with changed bytes, at once, slowly, or over and over."""
    answers = [of_bytes(rng.choice(ANSWERS), rng) for _ in range(3)]
    pace = rng.choice((0.0, 0.0, 0.001, 0.05))

    def serve(listening: socket.socket) -> None:
        while True:
            connection, _ = listening.accept()
            with connection, suppress(OSError):
                connection.recv(65536)
                answer = rng.choice(answers)
                step = max(len(answer), 1) if pace == 0.0 else 16
                for k in range(0, len(answer), step):
                    connection.sendall(answer[k : k + step])
                    time.sleep(pace)

    def task() -> None:
        from manifold.library.fetch import Entry, fetch

        listening = socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=serve, args=(listening,), daemon=True).start()
        url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        table = {"m": Entry("m", rng.choice((None, 7000)), None)}
        fetch(["m"], folder, base_url=url, table=table, timeout_s=0.5, attempts=1)

    def judge(ended: Ended) -> str | None:
        return (
            "silent: an unverified file" if ended.status == 0 and (folder / "m_spec.bsdf").exists() else None
        )

    return Case(_refusing(task), judge, f"pace {pace}")


KINDS = {
    "files": files, "models": models, "libraries": libraries, "scenes": scenes, "fits": fits, "servers": servers,
    "texts": texts, "instruments": instruments,
}  # fmt: skip
