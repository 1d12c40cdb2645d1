"""Exports of real files as engines draw them, beside Mitsuba's renders of the measured files.

    python tools/engines                  all materials in all engines, into benchmarks/results/engines.json
    python tools/engines --only satin     the materials whose names contain a word, or one engine; keeps no results
    python tools/engines --work FOLDER    with exports and pictures of before, where they are there
    python tools/engines --shape plane    textured surfaces alone; keeps no results

Balls in the lights in which errors are judged: Cycles (`bpy`) draws Blender's scripts, and glTF as Blender imports it,
MaterialX's GLSL renderer OpenPBR, standard_surface and UsdPreviewSurface, Adobe's openpbr-bsdf OpenPBR (the variable
OPENPBR_BSDF names the folder of its headers), three.js in Chromium glTF. Each engine's
exposure in a light is that in which a white Lambertian has the mean of Mitsuba's. Surfaces are planes of some materials
with textures of colours and normals, under suns, see `surfaces`. Real files are taken from
MANIFOLD_RGL_DIR, else ../shared/rgl/real; `make engines` installs what is needed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tools"), str(REPOSITORY / "tests")]

from helpers.browser import chromium  # noqa: E402
from helpers.three_js import ThreeJs, node_modules  # noqa: E402

from engines import balls, openpbr_bsdf, surfaces  # noqa: E402
from engines.balls import BALL, EDGE, Pictures, Scene, y_up  # noqa: E402
from manifold.core.metrics import Errors  # noqa: E402
from manifold.fit import exporting  # noqa: E402
from manifold.fit.exports.document import Export  # noqa: E402
from manifold.fit.exports.principled_values import PrincipledValues  # noqa: E402
from manifold.fit.exports.targets import Target, TargetBRDF  # noqa: E402
from manifold.registries import TARGETS  # noqa: E402

MATERIALS = (
    "acrylic_felt_green", "paper_blue", "satin_purple", "vch_golden_yellow", "chm_mint", "ilm_l3_37_matte",
    "cc_iris_purple_gem", "irid_flake_paint2",
)  # fmt: skip
"""Felt, paper, tinted satin, two foils, leather-like film, paint of two colours, iridescent flakes."""

SURFACES = ("acrylic_felt_green", "paper_blue", "satin_purple")
"""Of these, textured planes are drawn as well."""

WHITE = "white lambertian"
RESULTS = REPOSITORY / "benchmarks" / "results" / "engines.json"
_CYCLES_SAMPLES = (16, 128)  # a pixel: under suns, and in soft light
_MATERIALX_SAMPLES = 64  # of a lobe in soft light; its viewer takes 16 unless told otherwise
_MOST_WHITE = 1.0  # CIEDE2000 of the white Lambertian in the studio: more, and the light is turned
_PYTHON = REPOSITORY / ".venv-engines" / "bin" / "python"

Exported = dict[str, dict[str, Any]]
"""What an export says, with its path, by material."""


Writer = Callable[[exporting.Subject, Target, Path], dict[str, Any]]


def main() -> None:
    """Export, draw, compare, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", default=[], metavar="WORD")
    parser.add_argument("--engine", action="append", choices=ENGINES, help="by default all")
    parser.add_argument("--shape", action="append", choices=("ball", "plane"), help="by default both")
    parser.add_argument("--work", type=Path, help="folder of exports and pictures; by default a new one")
    parser.add_argument("--sheets", type=Path, help="folder of a picture for each light: a column a material")
    options = parser.parse_args()
    real = Path(os.environ.get("MANIFOLD_RGL_DIR", REPOSITORY.parent / "shared" / "rgl" / "real"))
    files = {n: real / f"{n}_rgb.bsdf" for n in MATERIALS if any(w in n for w in options.only or [""])}
    engines = options.engine or list(ENGINES)
    if "openpbr-bsdf" in engines:
        openpbr_bsdf.headers()
    with tempfile.TemporaryDirectory() as scratch:
        work = (options.work or Path(scratch)).resolve()
        versions: dict[str, str] = {}
        found = {"versions": versions}
        if "ball" in (options.shape or ["ball"]):
            found |= drawn_balls(files, engines, work, versions, options.sheets)
        if "plane" in (options.shape or ["plane"]):
            files = {name: path for name, path in files.items() if name in SURFACES}
            found["surfaces"] = drawn_surfaces(files, engines, work, versions, options.sheets)
    if not (options.only or options.engine or options.shape):
        RESULTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def drawn_balls(
    files: dict[str, Path], engines: list[str], work: Path, versions: dict[str, str], sheets: Path | None
) -> dict[str, Any]:
    """Differences of balls; versions of the engines are added."""
    measured = {
        name: balls.kept(work / "mitsuba", name, lambda path=path: balls.mitsuba(path))
        for name, path in (files | {WHITE: None}).items()
    }
    pictures, rows = {"measured": measured}, {}
    for engine in engines:
        targets, draw = ENGINES[engine]
        for target in targets:
            name = f"{target} in {engine}"
            made = exports(files, TARGETS[target], work)
            versions[engine] = version_of(work / name, partial(draw, made, BALL))
            drawn = {each: balls.read(work / name, each) for each in made}
            pictures[name] = balls.exposed(drawn, measured[WHITE], WHITE)
            rows[name] = compared(name, engine, made, pictures[name], measured)
    if sheets:
        balls.write_sheets(sheets, pictures)
    return {"summary": summary(rows), "exports": rows}


def drawn_surfaces(
    files: dict[str, Path], engines: list[str], work: Path, versions: dict[str, str], sheets: Path | None
) -> dict[str, Any]:
    """Differences of textured planes from Mitsuba's, by target and engine, material and sun."""
    true = {name: surfaces.mitsuba(path) for name, path in files.items()}
    pictures: dict[str, dict[str, surfaces.Pictures]] = {name: {"Mitsuba": true[name]} for name in files}
    rows: dict[str, Any] = {}
    for engine in engines:
        targets, draw = ENGINES[engine]
        for target in targets:
            if target == "usd" or engine == "openpbr-bsdf":  # which are given values, not files with textures
                continue
            name = f"{target} in {engine}"
            made = exports(files, TARGETS[target], work / "surfaces", surfaces.write)
            folder = work / f"{name}, plane"
            versions[engine] = version_of(folder, partial(draw, made, surfaces.PLANE))
            drawn = {each: balls.read(folder, each, surfaces.LAMPS) for each in made}
            white = drawn.pop(WHITE)
            rows[name] = {}
            print(f"\n{name}, planes")
            for each, picture in drawn.items():
                pictures[each][name] = surfaces.exposed(picture, white)
                model = TargetBRDF(TARGETS[target], made[each]["parameters"])
                rows[name][each] = surfaces.differences(pictures[each][name], true[each], model)
                for sun, errors in rows[name][each].items():
                    print(f"  {each:20} {sun:8}", _text(errors), flush=True)
    if sheets:
        for each, shown in pictures.items():
            surfaces.write_sheet(sheets / f"surface {each}.png", shown)
    return {"summary": surfaces.summary(rows), "exports": rows}


def version_of(folder: Path, draw: Callable[[Path], str]) -> str:
    """The version of an engine that has drawn into a folder, or draws now."""
    folder.mkdir(exist_ok=True)
    version = folder / "version.json"
    if not version.exists():
        version.write_text(json.dumps(draw(folder)), encoding="utf-8")
    return json.loads(version.read_text(encoding="utf-8"))


def write(subject: exporting.Subject, target: Target, path: Path) -> dict[str, Any]:
    """Export a material; what the export says."""
    return dict(exporting.export(subject, target, path).content or {})


def exports(files: dict[str, Path], target: Target, work: Path, written: Writer = write) -> Exported:
    """What `manifold export` says of every file, and where it was written, by material; a white Lambertian besides."""
    folder = work / target.name
    folder.mkdir(parents=True, exist_ok=True)
    made: Exported = {}
    for name, file in files.items():
        path = folder / f"{name}{target.suffix}"
        said = path.with_suffix(".export.json")
        if not said.exists():
            said.write_text(json.dumps(written(_subject(file), target, path)), encoding="utf-8")
        made[name] = json.loads(said.read_text(encoding="utf-8")) | {"path": path}
    material = PrincipledValues((1.0, 1.0, 1.0), specular=0.0, is_diffuse=True)
    white = Export(
        WHITE,
        target.name,
        target.parameters(material),
        {},
        Errors(),
        None,
        "nothing",
    )
    path = folder / f"{WHITE}{target.suffix}"
    path.write_bytes(target.content(white))
    made[WHITE] = white.to_json() | {"path": path}
    return made


@cache
def _subject(file: Path) -> exporting.Subject:
    return exporting.subject_of(file)


def cycles(exported: Exported, scene: Scene, folder: Path) -> str:
    """Draw in Cycles; the version of Blender."""
    lights = {
        name: _saved(folder, name, light.radiance("cycles"))
        if light.towards is None
        else light.towards.tolist()
        for name, light in scene.lights.items()
    }
    task = {
        "materials": {name: str(made["path"]) for name, made in exported.items()}, "lights": lights,
        "samples": _CYCLES_SAMPLES, "size": scene.size, "edge": EDGE, "filter": 1.0, "view": scene.view.tolist(),
        "shape": scene.shape, "folder": str(folder),
    }  # fmt: skip
    script = Path(__file__).with_name("cycles.py").read_text(encoding="utf-8")
    return _run([str(_PYTHON), "-c", script, json.dumps(task)])


def materialx(exported: Exported, scene: Scene, folder: Path) -> str:
    """Draw in MaterialX's renderer; its version."""
    materials = {name: str(made["path"]) for name, made in exported.items()}
    for name, made in exported.items():
        if made["target"] == "usd":  # which MaterialX reads as a node of its own
            described = folder / f"{name}.json"
            described.write_text(json.dumps(_inputs(made["parameters"])), encoding="utf-8")
            materials[name] = str(described)
    lights = {
        name: [
            _saved(folder, name, light.radiance("materialx", 64)),
            _saved(folder, f"irradiance {name}", light.irradiance("materialx")),
        ]
        if light.towards is None
        else {"towards": y_up(light.towards).tolist()}
        for name, light in scene.lights.items()
    }
    task = {
        "materials": materials, "lights": lights, "samples": _MATERIALX_SAMPLES, "size": scene.size,
        "finer": scene.finer, "edge": EDGE, "view": y_up(scene.view).tolist(), "shape": scene.shape,
        "folder": str(folder),
    }  # fmt: skip
    script = str(Path(__file__).with_name("materialx.py"))
    return _run(["xvfb-run", "-a", str(_PYTHON), script, json.dumps(task)])


def _inputs(parameters: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Types and values of MaterialX's inputs."""
    kinds = {list: "color3", int: "integer", float: "float"}
    return {
        name: (kinds[type(value)], ", ".join(map(str, value)) if isinstance(value, list) else str(value))
        for name, value in parameters.items()
    }


def adobe(exported: Exported, scene: Scene, folder: Path) -> str:
    """Evaluate Adobe's code in the sums that make pictures of balls; its version. It draws no planes."""
    for name, made in exported.items():
        pictures = balls.by_quadrature(openpbr_bsdf.AdobeBRDF(made["parameters"]))
        for key in scene.lights:
            np.save(folder / f"{name} {key}.npy", pictures[key][::-1])
    return openpbr_bsdf.VERSION


def three_js(exported: Exported, scene: Scene, folder: Path) -> str:
    """Draw in three.js; its version."""
    modules = node_modules()
    with chromium() as browser:
        page = ThreeJs(browser, modules)
        for name, made in exported.items():
            for key, light in scene.lights.items():
                lit = light.radiance("three.js") if light.towards is None else y_up(light.towards)
                finer = {} if scene.shape == "ball" else {"finer": scene.finer}  # of balls its own
                picture = page.ball(
                    made["path"], y_up(scene.view).tolist(), lit, scene.size, EDGE, scene.shape, **finer
                )
                np.save(folder / f"{name} {key}.npy", picture[::-1])
        if page.errors:
            raise RuntimeError("; ".join(page.errors))
    return json.loads((modules / "three" / "package.json").read_text(encoding="utf-8"))["version"]


ENGINES = {
    "cycles": (("blender", "gltf"), cycles),
    "materialx": (("openpbr", "standard-surface", "usd"), materialx),
    "openpbr-bsdf": (("openpbr",), adobe),
    "three.js": (("gltf",), three_js),
}
"""Targets that each engine draws, and what draws them: a file for each material and light, rows from below."""


def _run(command: list[str]) -> str:
    """What a command prints last, JSON."""
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    if made.returncode:
        raise RuntimeError(made.stdout[-3000:] + made.stderr[-3000:])
    return json.loads(made.stdout.strip().splitlines()[-1])


def _saved(folder: Path, name: str, values: Any) -> str:
    np.save(folder / f"light {name}.npy", values)
    return str(folder / f"light {name}.npy")


def compared(
    title: str, engine: str, exported: Exported, drawn: dict[str, Pictures], measured: dict[str, Pictures]
) -> dict[str, dict[str, Any]]:
    """What was printed, what is drawn, and how far that is from our own model of the target, by material."""
    white = balls.differences(drawn[WHITE], measured[WHITE])
    print(f"\n{title}\n  {'white':10}", _text(white))
    if white["studio 0"] > _MOST_WHITE:
        raise RuntimeError(f"{title}: a white Lambertian looks otherwise than in Mitsuba; are lights turned?")
    rows = {}
    for name, made in exported.items():
        if name == WHITE:
            continue
        printed_errors = made.get("implementations", {})
        own = next((program for program in printed_errors if program.lower() == engine), None)
        model = balls.by_quadrature(TargetBRDF(TARGETS[made["target"]], made["parameters"], own))
        printed = printed_errors.get(own, made["errors"])["lights"]
        lights = balls.differences(drawn[name], measured[name])
        mean, mean_printed = (statistics.fmean(each.values()) for each in (lights, printed))
        rows[name] = {
            "printed": mean_printed, "drawn": mean, "ratio": mean / mean_printed, "printed_lights": printed,
            "drawn_lights": lights, "drawn_from_model": balls.differences(drawn[name], model),
        }  # fmt: skip
        print(f"{name}: printed {mean_printed:.2f}, drawn {mean:.2f}, ratio {mean / mean_printed:.2f}")
        for key in ("printed_lights", "drawn_lights", "drawn_from_model"):
            print(f"  {key:16}", _text(rows[name][key]), flush=True)
    return rows


def _text(lights: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in lights.items())


def summary(rows: dict[str, dict[str, dict[str, Any]]]) -> dict[str, dict[str, float]]:
    """Median and largest ratio of what is drawn to what was printed, of every row and of all."""
    each = {name: [row["ratio"] for row in made.values()] for name, made in rows.items()}
    each["all"] = [ratio for ratios in each.values() for ratio in ratios]
    found = {name: {"median": statistics.median(r), "largest": max(r)} for name, r in each.items()}
    for name, one in found.items():
        print(f"{name}: ratio {one['median']:.2f} in the median, at most {one['largest']:.2f}")
    return found


if __name__ == "__main__":
    main()
