"""Requests that a served page may make, as command lines of this package; all others are refused.

Nothing of a request becomes a path but a plain name, and no shell is between.
"""

from __future__ import annotations

import itertools
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

from manifold.colour.lights import ENVIRONMENTS
from manifold.colour.pictures import SUFFIXES
from manifold.errors import UsageError
from manifold.fit.exports import TARGETS
from manifold.model.places import parse_path

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_ENDINGS = {"predict": ".bsdf", "render": ".png", "fit": ".fit.json", "export": ""}
_MOST_ROWS = 5000  # of a spectrum
_MOST_SAMPLE = 200  # characters of a sample's name
_PIXELS = r"[0-9]{1,6}(\.[0-9]{1,6})?"
_PHOTO_OPTIONS = ("circle", "turn", "elevation", "distance", "exposure")
_COORDINATE = r"-?[0-9]{1,3}(\.[0-9]{1,6})?"
_NUMBER = {"type": "number", "minimum": -sys.float_info.max, "maximum": sys.float_info.max}


@dataclass(frozen=True)
class Context:
    """What requests are about.

    Attributes:
        folder: where files are written.
        model: path of the model.
        library: path of its library.
        names: of the materials.
        latent_dim: Q.
        is_rgb: whether the library is linear sRGB.
    """

    folder: Path
    model: Path
    library: Path
    names: Sequence[str]
    latent_dim: int
    is_rgb: bool


@dataclass(frozen=True)
class Action:
    """A command line and what it writes.

    Attributes:
        title: for people.
        arguments: of `manifold`.
        output: the file that it writes, if any.
        picture: the picture among what it writes, if any.
        inputs: temporary folder of what it reads, removed at its end.
    """

    title: str
    arguments: tuple[str, ...]
    output: Path | None = None
    picture: Path | None = None
    inputs: Path | None = None


def action(
    kind: str, request: Mapping[str, Any], context: Context, inputs: Path, is_taken: Callable[[Path], bool]
) -> Action:
    """The action that a request asks for.

    Args:
        kind: `predict`, `render`, `fit` or `export`.
        request: `name` of the file without its ending, `latent`, which may be `FROM:TO:T` between two materials,
            and of colours at most one of `like`, `srgb` and `spectrum`, rows of wavelength in nm and reflectance;
            `replace`, whether a file of that name may be replaced; of an export also `target`, and `direct`, a
            boolean.
        context: of the page.
        inputs: temporary folder of what the commands read.
        is_taken: whether something is, or will be, at a path.
    """
    if kind not in _ENDINGS:
        raise UsageError(f"no action '{kind[:40]}', expected {', '.join(_ENDINGS)}")
    name = plain_name(request.get("name"))
    _require_valid(request, kind, context)
    ending, options = _ENDINGS[kind], [f"--latent={_latent(request['latent'], context)}"]
    if kind == "predict":
        ending = _bsdf_ending(context)
    elif kind == "export":
        ending = TARGETS[request["target"]].suffix
        options += [
            f"--target={request['target']}",
            *["--mapped"] * (not request.get("direct", True)),
            "--json=-",
        ]
    options += [f"--{key}={request[key]}" for key in ("like", "srgb") if key in request]
    output = _output(name, ending, context, request.get("replace", False), is_taken)
    spectrum = _write_spectrum(request["spectrum"], inputs) if "spectrum" in request else None
    if spectrum is not None:
        options.append(f"--reflectance={spectrum}")
    return Action(
        f"{kind} {output.name}", (kind, *options, f"--output={output}", *_model(context)), output,
        output if kind == "render" else None, spectrum and spectrum.parent,
    )  # fmt: skip


def complete(
    path: Path, sample: str, context: Context, is_taken: Callable[[Path], bool], *, replace: bool = False
) -> Action:
    """Complete the readings of a file that was dropped, and render the ball of what is found.

    Args:
        path: the file, alone in its folder; its name is that of what is written, without its ending.
        sample: which of a file's samples; may be empty.
        context, is_taken: as of `action`.
        replace: whether a file of that name may be replaced.
    """
    if len(sample) > _MOST_SAMPLE or not sample.isprintable():
        raise UsageError(f"sample: expected at most {_MOST_SAMPLE} printable characters")
    output = _output(
        path.name, _bsdf_ending(context), context, replace,
        lambda p: is_taken(p) or is_taken(p.with_suffix(".png")),
    )  # fmt: skip
    arguments = (
        "complete", str(path), f"--library={context.library}", f"--output={output}", "--picture", "--json=-",
        *([f"--sample={sample}"] if sample else []),
    )  # fmt: skip
    return Action(f"complete {output.name}", arguments, output, output.with_suffix(".png"), path.parent)


def locate(path: Path, context: Context) -> Action:
    """Find the latent of a file that was dropped, alone in its folder."""
    return Action(
        f"locate {path.name}", ("locate", str(path), "--json=-", *_model(context)), inputs=path.parent
    )


def photograph(
    path: Path, request: Mapping[str, Any], context: Context, is_taken: Callable[[Path], bool]
) -> Action:
    """Find the latent of a photographed ball that was dropped, and draw what differs from the prediction.

    Args:
        path: the photograph, followed by its light where that is a file, alone in its folder; its name is that of what
            is written.
        request: `suffix` of the photograph; `light`, a name, or `light_suffix` and `light_bytes` of the file, or
            `lamp`: `found`, `flash` or X,Y,Z, with a distance; and, if known, `circle` of the ball as X,Y,R, `turn` and
            `elevation` in degrees, `distance` in radii of the ball, and `exposure`, `free` where it is not known; see
            `manifold locate --photo`.
        context, is_taken: as of `action`.
    """
    _require_photograph(request, path.stat().st_size)
    picture = path.with_suffix(request["suffix"])
    path.rename(picture)
    light = request.get("light")
    if light is None and "lamp" not in request:
        light = path.with_name(f"{path.name}-light{request['light_suffix']}")
        size = int(request["light_bytes"])  # 100.0 is an integer in JSON
        with picture.open("r+b") as stream:
            stream.seek(-size, os.SEEK_END)
            light.write_bytes(stream.read())
            stream.truncate(picture.stat().st_size - size)
    given = [f"--{key}={request[key]}" for key in _PHOTO_OPTIONS if key in request]
    output = _output(path.name, "_photo.png", context, request.get("replace", False), is_taken)
    lit = f"--light={light}" if light is not None else f"--lamp={request['lamp']}"
    arguments = (
        "locate", f"--photo={picture}", lit, *given, f"--picture={output}", "--json=-",
        *_model(context),
    )  # fmt: skip
    return Action(f"locate {path.name}", arguments, output, output, path.parent)


def plain_name(name: Any) -> str:
    """A name that can stand in a path and before any ending."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise UsageError("name: expected letters, digits, - and _, 60 at most, a letter or digit first")
    return name


def _require_valid(request: Mapping[str, Any], kind: str, context: Context) -> None:
    """Raise UsageError unless a request has the fields of its kind, of the right types and within range."""
    row = {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2}
    fields: dict[str, Any] = {
        "name": {},
        "latent": {
            "type": ["array", "string"],
            "items": _NUMBER,
            "minItems": context.latent_dim,
            "maxItems": context.latent_dim,
        },
        "like": {"enum": list(context.names)},
        "srgb": {"type": "string", "pattern": r"\A#[0-9a-fA-F]{6}\Z"},
        "spectrum": {"type": "array", "items": row, "minItems": 2, "maxItems": _MOST_ROWS},
        "replace": {"type": "boolean"},
    }
    if kind == "export":
        fields |= {"target": {"enum": list(TARGETS)}, "direct": {"type": "boolean"}}
    required = ["name", "latent", *["target"] * (kind == "export")]
    schema = {"properties": fields, "required": required, "additionalProperties": False}
    for error in Draft202012Validator(schema).iter_errors(request):
        raise UsageError(f"request: {'.'.join(map(str, error.path))}: {error.message:.200}")
    if len({"like", "srgb", "spectrum"} & set(request)) > 1:
        raise UsageError("request: expected one of like, srgb and spectrum")


def _require_photograph(request: Mapping[str, Any], size: int) -> None:
    """Raise UsageError unless a request says how a photograph, and its light, of so many bytes were taken."""
    fields: dict[str, Any] = {
        "suffix": {"enum": list(SUFFIXES)},
        "light": {"enum": list(ENVIRONMENTS)},
        "lamp": {
            "type": "string",
            "pattern": rf"\A(found|flash|{_COORDINATE}(,{_COORDINATE}){{2}})(,{_PIXELS})?\Z",
        },
        "light_suffix": {"enum": list(SUFFIXES)},
        "light_bytes": {"type": "integer", "minimum": 1, "maximum": size - 1},
        "circle": {"type": "string", "pattern": rf"\A{_PIXELS},{_PIXELS},{_PIXELS}\Z"},
        "turn": {"type": "number", "minimum": -360, "maximum": 360},
        "elevation": {"type": "number", "minimum": -89, "maximum": 89},
        "distance": {"type": "number", "exclusiveMinimum": 1, "maximum": 1e6},
        "exposure": {"enum": ["free"]},
        "replace": {"type": "boolean"},
    }
    schema = {
        "type": "object", "properties": fields, "required": ["suffix"], "additionalProperties": False,
        "oneOf": [{"required": ["light"]}, {"required": ["light_bytes"]}, {"required": ["lamp"]}],
        "dependentRequired": {"light_bytes": ["light_suffix"], "light_suffix": ["light_bytes"]},
    }  # fmt: skip
    for error in Draft202012Validator(schema).iter_errors(request):
        raise UsageError(f"request: {'.'.join(map(str, error.path))}: {error.message:.200}")


def _latent(latent: list[float] | str, context: Context) -> str:
    if isinstance(latent, list):
        return ",".join(repr(float(v)) for v in latent)
    path = parse_path(latent, context.names)
    if path is None or not set(path[:2]) <= set(context.names):
        raise UsageError("latent: expected FROM:TO:T, of two materials of this model")
    return latent


def _write_spectrum(rows: Sequence[Sequence[float]], inputs: Path) -> Path:
    path = Path(tempfile.mkdtemp(dir=inputs), "reflectance.txt")
    path.write_text("".join(f"{float(nm)!r} {float(value)!r}\n" for nm, value in rows))
    return path


def _model(context: Context) -> tuple[str, ...]:
    return (f"--model={context.model}", f"--library={context.library}")


def _bsdf_ending(context: Context) -> str:
    return f"_{'rgb' if context.is_rgb else 'spec'}.bsdf"


def _output(
    name: str, ending: str, context: Context, replace: bool, is_taken: Callable[[Path], bool]
) -> Path:
    """A path in the folder; unless it may be replaced, a number is added to a name that is taken."""
    numbered = (f"{name}{f'-{copy}' if copy > 1 else ''}{ending}" for copy in itertools.count(1))
    paths = (context.folder / name for name in numbered)
    return next(path for path in paths if replace or not is_taken(path))
