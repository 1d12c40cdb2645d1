"""What a served page may ask for, as command lines of this package; everything else is refused.

Nothing of a request becomes a path but a plain name, and no shell is between.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manifold.errors import UsageError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}")
_ENDINGS = {"predict": ".bsdf", "render": ".png", "fit": ".json"}
_MOST_ROWS = 5000  # of a spectrum
_MOST_COPIES = 1000


@dataclass(frozen=True)
class Context:
    """What requests are about.

    Attributes:
        folder: where files are written.
        model: path of the model.
        library: where its library is, if not where the model remembers it.
        names: of the materials.
        latent_dim: Q.
        is_rgb: whether the library is linear sRGB.
    """

    folder: Path
    model: Path
    library: Path | None
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
        spectrum: text of a reflectance file whose path takes the place of `SPECTRUM` among the arguments, if any.
    """

    title: str
    arguments: tuple[str, ...]
    output: Path | None = None
    spectrum: str | None = None


SPECTRUM = "--reflectance=SPECTRUM"


def action(
    kind: str,
    request: Mapping[str, Any],
    context: Context,
    is_taken: Callable[[Path], bool] = os.path.lexists,
) -> Action:
    """The action that a request asks for.

    Args:
        kind: `predict`, `render` or `fit`.
        request: `name` of the file without its ending, `latent`, and of colours at most one of `like`, `srgb` and
            `spectrum`, rows of wavelength in nm and reflectance.
        context: of the page.
        is_taken: whether something is, or will be, at a path.
    Raises:
        UsageError: it is anything else.
    """
    if kind not in _ENDINGS:
        raise UsageError(f"no action '{kind[:40]}', expected {', '.join(_ENDINGS)}")
    unknown = set(request) - {"name", "latent", "like", "srgb", "spectrum"}
    if unknown:
        raise UsageError(
            f"found {sorted(unknown)[0][:40]!r} in the request, expected name, latent, and a colour"
        )
    output = _output(request.get("name"), kind, context, is_taken)
    colour, spectrum = _colour(request, context)
    arguments = (
        kind, f"--latent={_latent(request.get('latent'), context)}", *colour, f"--output={output}", *_model(context),
    )  # fmt: skip
    return Action(f"{kind} {output.name}", arguments, output, spectrum)


def locate(path: Path, shown: str, context: Context) -> Action:
    """Find the place of a file that was dropped."""
    return Action(f"locate {shown}", ("locate", str(path), "--json=-", *_model(context)))


def _model(context: Context) -> tuple[str, ...]:
    library = () if context.library is None else (f"--library={context.library}",)
    return (f"--model={context.model}", *library)


def _latent(latent: Any, context: Context) -> str:
    if not isinstance(latent, list) or len(latent) != context.latent_dim or not all(map(_is_number, latent)):
        raise UsageError(f"latent: expected {context.latent_dim} finite numbers")
    return ",".join(repr(float(v)) for v in latent)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _colour(request: Mapping[str, Any], context: Context) -> tuple[tuple[str, ...], str | None]:
    """Options of the colour, and the text of a spectrum file."""
    given = [key for key in ("like", "srgb", "spectrum") if request.get(key) is not None]
    if len(given) > 1:
        raise UsageError(f"found {' and '.join(given)}, expected one of them; a material has one colour")
    if "like" in given:
        if request["like"] not in context.names:
            raise UsageError("like: no such material in this model")
        return (f"--like={request['like']}",), None
    if "srgb" in given:
        if not (isinstance(request["srgb"], str) and _COLOUR.fullmatch(request["srgb"])):
            raise UsageError("srgb: expected #rrggbb")
        return (f"--srgb={request['srgb']}",), None
    if "spectrum" in given:
        return (SPECTRUM,), _spectrum(request["spectrum"])
    return (), None


def _spectrum(rows: Any) -> str:
    is_table = isinstance(rows, list) and 2 <= len(rows) <= _MOST_ROWS
    if not is_table or not all(isinstance(r, list) and len(r) == 2 and all(map(_is_number, r)) for r in rows):
        raise UsageError(f"spectrum: expected 2 to {_MOST_ROWS} rows of wavelength in nm and reflectance")
    return "".join(f"{float(nm)!r} {float(value)!r}\n" for nm, value in rows)


def _output(name: Any, kind: str, context: Context, is_taken: Callable[[Path], bool]) -> Path:
    """A path in the folder that nothing is at: a number is added to a name that is taken."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise UsageError("name: expected letters, digits, - and _, 60 at most, a letter or digit first")
    kind_of_file = ("_rgb" if context.is_rgb else "_spec") if kind == "predict" else ""
    for copy in range(1, _MOST_COPIES):
        number = f"-{copy}" if copy > 1 else ""
        path = context.folder / f"{name}{number}{kind_of_file}{_ENDINGS[kind]}"
        if not is_taken(path):
            return path
    raise UsageError(f"name: {_MOST_COPIES} files are called {name}; choose another")
