"""The commands that a served page may call, with a schema for the requests of each.

All other requests are refused. A request can only give the plain name of a file, never a path.
"""

from __future__ import annotations

import itertools
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manifold.colour.lights import ENVIRONMENTS
from manifold.colour.picture_files import SUFFIXES
from manifold.colour.reflectances import ReflectanceSpectrum
from manifold.core.errors import UsageError
from manifold.core.extras import require
from manifold.estimate.sightings import PhotoRequest
from manifold.estimate.sources import FileSource, PlaceSource
from manifold.model.colours import ColourChoice
from manifold.model.places import parse_walk
from manifold.registries import FIT_SUFFIX, TARGETS, Registry

Request = Mapping[str, Any]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_MOST_ROWS = 5000  # rows of a spectrum
_MOST_SAMPLE = 200  # characters of a sample's name
_NO_CONTROLS = r"\A[^\x00-\x1f\x7f-\x9f]*\Z"
_PIXELS = r"[0-9]{1,6}(\.[0-9]{1,6})?"
_COORDINATE = r"-?[0-9]{1,3}(\.[0-9]{1,6})?"
_NUMBER = {"type": "number", "minimum": -sys.float_info.max, "maximum": sys.float_info.max}


@dataclass(frozen=True)
class Context:
    """The model and library of requests, and the folder where files are written; `latent_dim` is Q."""

    folder: Path
    model: Path
    library: Path
    names: Sequence[str]
    latent_dim: int
    is_rgb: bool


@dataclass(frozen=True)
class PageCommand:
    """A command that the page may call: a public function, and its arguments from a request.

    Attributes:
        function: import path `module:name` of the function, whose result has `to_json`.
        arguments: function that returns its arguments, given a valid request, the context, the output, and the sent
            file.
        schema: JSON schema of a request.
        ending: ending of the output's name, with `{bands}` and `{target}`; None for a command that writes nothing.
        has_picture: whether the output is a picture, or has one beside it.
        takes_file: whether a file is sent; the request is then in a header.
    """

    function: str
    arguments: Callable[[Request, Context, Path, Path], dict[str, Any]]
    schema: dict[str, Any]
    ending: str | None = None
    has_picture: bool = False
    takes_file: bool = False

    def check(self, request: Request) -> None:
        """Raise UsageError unless a request has the fields of this command, of the right types and within range."""
        for error in require("jsonschema").Draft202012Validator(self.schema).iter_errors(request):
            raise UsageError(f"request: {'.'.join(map(str, error.path))}: {error.message:.200}")
        if not isinstance(request["name"], str) or not _NAME.fullmatch(request["name"]):
            raise UsageError("name: expected letters, digits, - and _, 60 at most, a letter or digit first")

    def output(self, request: Request, context: Context, is_taken: Callable[[Path], bool]) -> Path | None:
        """Return a path in the folder; a number is added to a taken name unless the file may be replaced."""
        if self.ending is None:
            return None
        target = TARGETS[request["target"]].suffix if "target" in request else ""
        ending = self.ending.format(bands="rgb" if context.is_rgb else "spec", target=target)
        names = (f"{request['name']}{f'-{k}' if k > 1 else ''}{ending}" for k in itertools.count(1))

        def is_free(path: Path) -> bool:
            return not is_taken(path) and not (self.has_picture and is_taken(path.with_suffix(".png")))

        paths = (context.folder / name for name in names)
        return next(path for path in paths if request.get("replace", False) or is_free(path))


@dataclass(frozen=True)
class Call:
    """A command with its arguments.

    Attributes:
        subject: text that names what the command reads or writes.
        arguments: arguments of its function, which can be pickled.
        picture: path of the picture that it writes, if any.
        inputs: temporary folder of the files that it reads, which is removed at the end.
    """

    command: str
    subject: str
    arguments: dict[str, Any]
    output: Path | None = None
    picture: Path | None = None
    inputs: Path | None = None


def call_of(
    name: str, request: Request, context: Context, is_taken: Callable[[Path], bool], file: Path | None = None
) -> Call:
    """Return the call that a request describes; a sent file must be alone in its folder.

    The request holds `name`, the name of the output without ending; `replace`, whether an existing file may be
    replaced; `latent`, which may be `FROM:TO:T`; at most one of the colours `like`, `srgb` and `spectrum` (rows of
    wavelength in nm and reflectance); and further fields named like the options of the command line. `is_taken`
    returns whether a path exists or will be written by a waiting job.
    """
    command = COMMANDS[name]
    command.check(request)
    output = command.output(request, context, is_taken)
    arguments = command.arguments(request, context, output or Path(), file or Path())
    subject = request["name"] if output is None else output.name
    picture = output.with_suffix(".png") if output is not None and command.has_picture else None
    return Call(name, subject, arguments, output, picture, None if file is None else file.parent)


def _place(request: Request, context: Context) -> PlaceSource:
    """Return the prediction that a request shows."""
    latent, like, rows = request["latent"], request.get("like"), request.get("spectrum")
    if isinstance(latent, str):
        walk = parse_walk(latent, context.names)
        if walk is None or not set(walk[:2]) <= set(context.names):
            raise UsageError("latent: expected FROM:TO:T, of two materials of this model")
    elif len(latent) != context.latent_dim:
        raise UsageError(f"latent: found {len(latent)} numbers, expected {context.latent_dim}")
    else:
        latent = [float(v) for v in latent]
    if like is not None and like not in context.names:
        raise UsageError(f"like: no material of this model is called '{like:.60}'")
    spectrum = None
    if rows is not None:
        nm, values = zip(*rows, strict=True)
        spectrum = ReflectanceSpectrum(nm, values)
    colour = ColourChoice(like, spectrum, request.get("srgb"))
    return PlaceSource(context.model, latent, context.library, colour)


def _predict(request: Request, context: Context, output: Path, file: Path) -> dict[str, Any]:
    place = _place(request, context)
    return {
        "model": place.model, "latent": place.place, "output": output, "library": place.library,
        "colour": place.colour,
    }  # fmt: skip


def _photographed(request: Request, context: Context, output: Path, file: Path) -> dict[str, Any]:
    """Return the arguments of a photograph, which is followed by its light if `light_bytes` says so."""
    photograph, light = file.with_suffix(request["suffix"]), request.get("light")
    file.rename(photograph)
    if "light_bytes" in request:
        size = photograph.stat().st_size - int(request["light_bytes"])  # 100.0 is an integer in JSON
        if size < 1:
            raise UsageError("light_bytes: expected less than the size of the body")
        light = file.with_name(f"{file.name}-light{request['light_suffix']}")
        with photograph.open("r+b") as stream:
            stream.seek(size)
            light.write_bytes(stream.read())
            stream.truncate(size)
    is_free = "exposure" in request or "lamp" in request
    asked = PhotoRequest(
        [photograph], [] if light is None else [str(light)], [request["circle"]] if "circle" in request else [],
        [request.get("turn", 0.0)], request.get("elevation", 0.0), request.get("distance", math.inf),
        None if is_free else 1.0, lamps=[request["lamp"]] if "lamp" in request else [],
    )  # fmt: skip
    return {"model": context.model, "request": asked, "library": context.library, "picture": output}


def _schema(fields: dict[str, Any], required: Sequence[str] = (), **rules: Any) -> dict[str, Any]:
    """Return the schema of a request that also has a name, which `PageCommand.check` reads."""
    properties = {"name": {}, "replace": {"type": "boolean"}, **fields}
    return {"properties": properties, "required": ["name", *required], "additionalProperties": False, **rules}


_ROW = {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2}
_SHOWN = {
    "latent": {"type": ["array", "string"], "items": _NUMBER},
    "like": {"type": "string"},
    "srgb": {"type": "string", "pattern": r"\A#[0-9a-fA-F]{6}\Z"},
    "spectrum": {"type": "array", "items": _ROW, "minItems": 2, "maxItems": _MOST_ROWS},
}
_PHOTO = {
    "suffix": {"enum": list(SUFFIXES)},
    "light": {"enum": list(ENVIRONMENTS)},
    "lamp": {
        "type": "string",
        "pattern": rf"\A(found|flash|{_COORDINATE}(,{_COORDINATE}){{2}})(,{_PIXELS})?\Z",
    },
    "light_suffix": {"enum": list(SUFFIXES)},
    "light_bytes": {"type": "integer", "minimum": 1},
    "circle": {"type": "string", "pattern": rf"\A{_PIXELS},{_PIXELS},{_PIXELS}\Z"},
    "turn": {"type": "number", "minimum": -360, "maximum": 360},
    "elevation": {"type": "number", "minimum": -89, "maximum": 89},
    "distance": {"type": "number", "exclusiveMinimum": 1, "maximum": 1e6},
    "exposure": {"enum": ["free"]},
}


_BSDF = "_{bands}.bsdf"

COMMANDS: Registry[PageCommand] = Registry("command of the page", {
    "predict": PageCommand(
        "manifold.estimate.predictions:predict", _predict, _schema(_SHOWN, ["latent"]), _BSDF,
    ),
    "render": PageCommand(
        "manifold.pictures.renders:render",
        lambda request, context, output, file: {"source": _place(request, context), "output": output},
        _schema(_SHOWN, ["latent"]), ".png", has_picture=True,
    ),
    "fit": PageCommand(
        "manifold.fit.fits:fit",
        lambda request, context, output, file: {"source": _place(request, context), "target": output},
        _schema(_SHOWN, ["latent"]), FIT_SUFFIX,
    ),
    "export": PageCommand(
        "manifold.fit.exporting:export",
        lambda request, context, output, file: {
            "subject": _place(request, context), "target": request["target"], "path": output,
        },
        _schema({**_SHOWN, "target": {"enum": list(TARGETS)}}, ["latent", "target"]),
        "{target}",
    ),
    "complete": PageCommand(
        "manifold.estimate.completions:complete",
        lambda request, context, output, file: {
            "library": context.library, "readings": file, "output": output,
            "sample": request.get("sample") or None, "picture": output.with_suffix(".png"),
        },
        _schema({"sample": {"type": "string", "maxLength": _MOST_SAMPLE, "pattern": _NO_CONTROLS}}),
        ".bsdf", has_picture=True, takes_file=True,  # spectra keep their bands, whatever the library's
    ),
    "locate": PageCommand(
        "manifold.estimate.descriptions:locate",
        lambda request, context, output, file: {
            "model": context.model, "path": FileSource(file), "library": context.library
        },
        _schema({}), takes_file=True,
    ),
    "photograph": PageCommand(
        "manifold.estimate.descriptions:locate_photographs", _photographed,
        _schema(
            _PHOTO, ["suffix"], oneOf=[{"required": [key]} for key in ("light", "light_bytes", "lamp")],
            dependentRequired={"light_bytes": ["light_suffix"], "light_suffix": ["light_bytes"]},
        ),
        "_photo.png", has_picture=True, takes_file=True,
    ),
}.items())  # fmt: skip
"""The commands of the page, by name."""
