"""The Typer application to which every module adds its commands."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand

from . import outputs

_REGISTRY = re.compile(r"\{(manifold[.\w]*)\.(\w+)\}")


class Command(TyperCommand):
    """A command that checks its outputs before it runs."""

    def get_help(self, ctx: Any) -> str:
        """As Typer's; `{manifold.mapping.MAPPINGS}` stands for the names in that registry, which is imported now."""
        for each in (self, *self.params):
            if text := getattr(each, "help", None):
                each.help = _REGISTRY.sub(lambda found: str(getattr(import_module(found[1]), found[2])), text)
        return super().get_help(ctx)

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
        """As `typer.Typer.command`; a parameter that is a dataclass of options is these options."""
        add = super().command(*args, cls=Command, **kwargs)

        def added(command: Callable[..., Any]) -> Callable[..., Any]:
            add(with_groups(command))
            return command

        return added


def with_groups(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command of its parameters, and the fields of those of them that are dataclasses of options."""
    signature = inspect.signature(command, eval_str=True)
    groups = {p.name: p.annotation for p in signature.parameters.values() if is_dataclass(p.annotation)}
    if not groups:
        return command
    parameters = []
    for parameter in signature.parameters.values():
        group = groups.get(parameter.name)
        hints = {} if group is None else get_type_hints(group, include_extras=True)
        own = [
            parameter.replace(name=one.name, annotation=hints[one.name], default=one.default)
            for one in (() if group is None else fields(group))
        ]
        parameters += own or [parameter]

    def run(**given: Any) -> Any:
        made = {
            name: group(**{one.name: given.pop(one.name) for one in fields(group)})
            for name, group in groups.items()
        }
        return command(**given, **made)

    run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run


app = Application(
    name="manifold",
    help="Learn a manifold of materials from measured spectral BRDFs, and predict BRDFs that were not measured.",
    epilog="Start with `manifold demo`, which runs the main job on built-in materials.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
