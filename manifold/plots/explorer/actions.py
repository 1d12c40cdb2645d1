"""Requests that a served page may make, as command lines of this package; all others are refused.

Nothing of a request becomes a path but a plain name, and no shell is between.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manifold.errors import UsageError
from manifold.fitting.exports import TARGETS
from manifold.model.latents import on_path

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}")
_ENDINGS = {"predict": ".bsdf", "render": ".png", "fit": ".fit.json", "export": ""}
_MOST_ROWS = 5000  # of a spectrum
_MOST_COPIES = 1000
_MOST_SAMPLE = 200  # characters of a sample's name


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
        spectrum: text of a reflectance file whose path takes the place of `SPECTRUM` among the arguments, if any.
    """

    title: str
    arguments: tuple[str, ...]
    output: Path | None = None
    picture: Path | None = None
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
        kind: `predict`, `render`, `fit` or `export`.
        request: `name` of the file without its ending, `latent`, which may be `FROM:TO:T` between two materials,
            and of colours at most one of `like`, `srgb` and `spectrum`, rows of wavelength in nm and reflectance;
            `replace`, whether a file of that name may be replaced; of an export also `target`, and `direct`, a
            boolean.
        context: of the page.
        is_taken: whether something is, or will be, at a path.
    Raises:
        UsageError: it is anything else.
    """
    if kind not in _ENDINGS:
        raise UsageError(f"no action '{kind[:40]}', expected {', '.join(_ENDINGS)}")
    expected = {
        "name",
        "latent",
        "like",
        "srgb",
        "spectrum",
        "replace",
        *(["target", "direct"] if kind == "export" else []),
    }
    unknown = set(request) - expected
    if unknown:
        raise UsageError(
            f"found {sorted(unknown)[0][:40]!r} in the request, expected name, latent, and a colour"
        )
    ending = _ENDINGS[kind]
    options: tuple[str, ...] = ()
    if kind == "predict":
        ending = f"_{'rgb' if context.is_rgb else 'spec'}{ending}"
    elif kind == "export":
        ending, options = _export(request)
    replace = request.get("replace", False)
    if not isinstance(replace, bool):
        raise UsageError("replace: expected true or false")
    output = _output(request.get("name"), ending, context, _never if replace else is_taken)
    colour, spectrum = _colour(request, context)
    arguments = (
        kind, f"--latent={_latent(request.get('latent'), context)}", *colour, f"--output={output}", *_model(context),
        *options,
    )  # fmt: skip
    picture = output if kind == "render" else None
    return Action(f"{kind} {output.name}", arguments, output, picture, spectrum)


def complete(
    path: Path, name: Any, sample: str, context: Context, is_taken: Callable[[Path], bool], *, replace: bool = False
) -> Action:  # fmt: skip
    """Complete the readings of a file that was dropped, and render the ball of what is found.

    Args:
        path: the file.
        name: of what is written, without its ending.
        sample: which of a file's samples; may be empty.
        context, is_taken: as of `action`.
        replace: whether a file of that name may be replaced.
    Raises:
        UsageError: a name is none.
    """
    if len(sample) > _MOST_SAMPLE or not sample.isprintable():
        raise UsageError(f"sample: expected at most {_MOST_SAMPLE} printable characters")
    ending = f"_{'rgb' if context.is_rgb else 'spec'}.bsdf"
    taken = _never if replace else lambda p: is_taken(p) or is_taken(p.with_suffix(".png"))
    output = _output(name, ending, context, taken)
    _require_no_link(output.with_suffix(".png"))
    arguments = (
        "complete", str(path), f"--library={context.library}", f"--output={output}", "--picture", "--json=-",
        *([f"--sample={sample}"] if sample else []),
    )  # fmt: skip
    return Action(f"complete {output.name}", arguments, output, output.with_suffix(".png"))


def _export(request: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Ending and options of an export."""
    target, direct = request.get("target"), request.get("direct", False)
    if not isinstance(target, str) or target not in TARGETS:
        raise UsageError(f"target: expected one of {', '.join(TARGETS)}")
    if not isinstance(direct, bool):
        raise UsageError("direct: expected true or false")
    options = (f"--target={target}", *["--direct"] * direct, "--json=-")
    return TARGETS[target].suffix, options


def locate(path: Path, context: Context) -> Action:
    """Find the place of a file that was dropped."""
    return Action(f"locate {path.name}", ("locate", str(path), "--json=-", *_model(context)))


def _model(context: Context) -> tuple[str, ...]:
    return (f"--model={context.model}", f"--library={context.library}")


def _latent(latent: Any, context: Context) -> str:
    if isinstance(latent, str):
        path = on_path(latent, context.names)
        if path is None or not {path.start, path.end} <= set(context.names):
            raise UsageError("latent: expected FROM:TO:T, of two materials of this model")
        return latent
    if not isinstance(latent, list) or len(latent) != context.latent_dim or not all(map(_is_number, latent)):
        raise UsageError(f"latent: expected {context.latent_dim} finite numbers")
    return ",".join(repr(float(v)) for v in latent)


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
    )


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


def _never(path: Path) -> bool:
    """No name counts as taken: the command itself refuses to replace a file that it did not write."""
    return False


def _require_no_link(path: Path) -> None:
    """Raise UsageError for a link: the file that it names would be replaced, which may lie elsewhere."""
    if path.is_symlink():
        raise UsageError(f"name: {path.name} is a link; choose another")


def plain_name(name: Any) -> str:
    """A name that can stand in a path and before any ending.

    Raises:
        UsageError: it is none.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise UsageError("name: expected letters, digits, - and _, 60 at most, a letter or digit first")
    return name


def _output(name: Any, ending: str, context: Context, is_taken: Callable[[Path], bool]) -> Path:
    """A path in the folder that nothing is at: a number is added to a name that is taken."""
    name = plain_name(name)
    for copy in range(1, _MOST_COPIES):
        number = f"-{copy}" if copy > 1 else ""
        path = context.folder / f"{name}{number}{ending}"
        if not is_taken(path):
            _require_no_link(path)
            return path
    raise UsageError(f"name: {_MOST_COPIES} files are called {name}; choose another")
