"""The Typer application to which every module adds its commands."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand

from . import outputs


class Command(TyperCommand):
    """A command that checks its outputs before it runs."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """As Typer's, but arguments stand by their names alone, without a type such as `<list[Path]>`."""
        for parameter in self.params:
            if parameter.param_type_name == "argument":
                parameter.display_type_rich = lambda ctx: None  # type: ignore[method-assign]
        super().format_options(ctx, formatter)

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        """As Typer's. Raises UsageError where an output cannot be written to."""
        assert self.callback is not None
        outputs.check_all(inspect.unwrap(self.callback), ctx.params)
        return super().invoke(ctx)


class Application(typer.Typer):
    """A Typer of such commands."""

    def command(self, *args: Any, **kwargs: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """As `typer.Typer.command`."""
        return super().command(*args, cls=Command, **kwargs)


app = Application(
    name="manifold",
    help="Learn a manifold of materials from measured spectral BRDFs, and predict BRDFs that were not measured.",
    epilog="Start with `manifold demo`, which runs everything on the built-in synthetic corpus.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
