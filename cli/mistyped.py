"""Commands whose help has no Python types; wrong values of options are told in one line what was expected."""

from __future__ import annotations

import inspect
import types
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from typer.core import TyperCommand

from manifold.errors import UsageError


class Command(TyperCommand):
    """A command whose help and wrong values are told alike, whatever words the version of Typer has for them."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """As Typer's, but arguments stand by their names alone, without a type such as `<list[Path]>`."""
        for parameter in self.params:
            if parameter.param_type_name == "argument":
                parameter.display_type_rich = lambda ctx: None  # type: ignore[method-assign]
        super().format_options(ctx, formatter)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As Typer's.

        Raises:
            UsageError: a value is not of its option's kind, or a path is empty.
        """
        given = list(args)
        if any(word == "" or word.endswith("=") for word in given):  # rarely
            self._refuse_empty_paths(ctx, given)
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            found = None if error.param is None else self._found(ctx, given, str(error.param.name))
            if error.param is None or found is None:
                raise  # an argument is missing, which Typer says well
            expected = _expected(self._annotation(str(error.param.name)))
            name = error.param.opts[0]
            raise UsageError(
                f"{name} {found!r}: expected {expected}; see `{ctx.command_path} --help`"
            ) from None

    def _found(self, ctx: Any, args: list[str], name: str) -> str | None:
        """The first value that was given for a parameter, as it was typed."""
        return next(iter(self._typed(ctx, args).get(name, [])), None)

    def _typed(self, ctx: Any, args: list[str]) -> dict[str, list[str]]:
        """The values that were given for every parameter, as they were typed."""
        given = self.make_parser(ctx).parse_args(list(args))[0]
        several = {
            name: value if isinstance(value, list | tuple) else [value] for name, value in given.items()
        }
        return {name: [v for v in values if isinstance(v, str)] for name, values in several.items()}

    def _refuse_empty_paths(self, ctx: Any, args: list[str]) -> None:
        """Raise UsageError for `""`, which a shell makes of a variable that is not set, and Python the folder `.`."""
        typed = self._typed(ctx, args)
        for parameter in self.params:
            if (
                "" in typed.get(str(parameter.name), [])
                and kind_of(self._annotation(str(parameter.name))) is Path
            ):
                name = parameter.opts[0] if parameter.opts[0].startswith("-") else parameter.metavar
                raise UsageError(f"{name} '': expected a path; see `{ctx.command_path} --help`")

    def _annotation(self, name: str) -> Any:
        return inspect.signature(self.callback, eval_str=True).parameters[name].annotation  # type: ignore[arg-type]


def _expected(annotation: Any) -> str:
    """What a parameter of this annotation takes, in words."""
    hints = get_args(annotation)[1:] if get_origin(annotation) is Annotated else ()
    bounds = next((hint for hint in hints if hasattr(hint, "min")), None)
    kind = kind_of(annotation)
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, get_args(kind)))}"
    words = {int: "a whole number", float: "a number"}.get(kind, "another value")
    least, most = getattr(bounds, "min", None), getattr(bounds, "max", None)
    if least is not None:
        words += f" from {least}"
    return words if most is None else f"{words} {'to' if least is not None else 'up to'} {most}"


def kind_of(annotation: Any) -> Any:
    """The type itself: without notes, None and lists around it."""
    while get_origin(annotation) in (Annotated, Union, types.UnionType, list):
        annotation = next(part for part in get_args(annotation) if part is not type(None))
    return annotation
