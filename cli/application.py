"""The Typer application to which every module adds its commands, and the layout of its help."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection
from copy import copy
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from . import outputs
from .defaults import use_built_in

_NAMED = re.compile(r"\{(manifold[.\w]*)\.(\w+)(:[^}]*)?\}")
_RANGE = re.compile(r"(; |\s*\[)[-\d.e<>=]*x[-\d.e<>=]*\]$")  # such as `; 2<=x<=128]`


GROUPS = {
    "Estimate from measurements": {
        "complete": ("completion", "Estimate a whole BRDF from a few readings."),
        "photograph": ("photograph", "Estimate the BRDF of a painted ball or tin from photographs."),
        "surface": ("surface", "Make textures and materials from a workbook's own pictures."),
        "reconstruct": ("model", "Approximate a measured file by a combination of a library's materials."),
        "calibrate": ("completion", "Fit the colour correction of an instrument to a reference instrument."),
    },
    "Map": {
        "embed": ("model", "Fit a manifold to a library."),
        "predict": ("model", "Write the material at a point of the map, or edit a file."),
        "walk": ("picture", "Draw a walk between two materials."),
        "locate": ("model", "Find the point of the map for a measured file."),
        "find": (
            "library",
            "Find the materials of a library nearest to a material, or to a colour and gloss.",
        ),
        "map": ("picture", "Draw the map of materials as rendered balls."),
        "explore": ("picture", "Explore the map in a web page or notebook."),
    },
    "Render and export": {
        "render": ("picture", "Render a ball of a measured or predicted material."),
        "compare": ("picture", "Compare two pictures, or two rendered materials."),
        "slices": ("picture", "Draw BRDF values over angles or wavelengths."),
        "export": ("fit", "Write a material for engines and renderers."),
        "fit": ("fit", "Fit the parameters of a BSDF, by default principled."),
    },
    "Files": {
        "info": ("library", "Show what a file, a library, a model or a fit contains."),
        "import": ("library", "Import files or folders into a library."),
        "convert": ("instrument", "Convert between BRDF, instrument and simulator files."),
        "fetch": ("library", "Download files of the RGL database."),
        "compact": ("library", "Compress a library to a few per cent of its size."),
    },
    "Study": {
        "demo": ("report", "Run all main steps on built-in materials."),
        "report": ("report", "Evaluate a model by errors of left-out materials."),
        "chart": ("report", "Measure speed against accuracy of many settings on one library."),
        "stability": ("report", "Test known failure modes, and whether they are detected."),
        "budget": (
            "report",
            "Find the cheapest representation of a scene's materials that preserves its picture.",
        ),
        "corpus": ("library", "Write the built-in synthetic corpus."),
    },
}
"""Commands by the groups of `manifold --help`: the module `cli/MODULE_commands.py` of each, and its line there."""

COMMANDS = {name: entry for entries in GROUPS.values() for name, entry in entries.items()}
COLOUR, LIGHT, TAKEN, GRID, SHARED = (
    "Colour", "Light and picture", "How the pictures were taken", "Written file", "Sharing the work",
)  # fmt: skip
"""Panels of options in helps, in this order, behind the options that have none."""
_PANELS = ("", COLOUR, LIGHT, TAKEN, GRID, SHARED)
_MOST_SHOWN = 20  # options in a help; `--help-all` shows all


def load(names: Collection[str]) -> None:
    """Import the modules of commands, and expand dataclasses among their parameters into options."""
    for module in dict.fromkeys(COMMANDS[name][0] for name in names):
        import_module(f".{module}_commands", __package__)
    for each in app.registered_commands:
        if each.name in names and each.callback is not None:
            each.callback = with_groups(each.callback)


class Command(TyperCommand):
    """A command that checks its outputs before it runs."""

    shows_all = False
    """Whether helps show all options; set by `--help-all`."""

    def get_help(self, ctx: Any) -> str:
        """Return the help, in which `{manifold.registries.MAPPINGS}` stands for the names in that registry.

        `{manifold.core.defaults.GONIOMETER:.0%}` stands for that default, in the format after the colon.
        """

        def value(found: re.Match[str]) -> str:
            return format(getattr(import_module(found[1]), found[2]), (found[3] or ":")[1:])

        each: Any
        for each in (self, *self.params):
            if text := getattr(each, "help", None):
                each.help = _NAMED.sub(value, text)
        return super().get_help(ctx)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the names of the arguments, then the options by panel; options for experts appear only on request."""
        arguments: list[tuple[str, str]] = []
        panels: dict[str, list[tuple[str, str]]] = {panel: [] for panel in _PANELS}
        parameter: Any
        for parameter in self.get_params(ctx):
            if parameter.param_type_name == "argument":
                parameter.display_type_rich = lambda ctx: None
                arguments.append(parameter.get_help_record(ctx))
            elif (record := _without_range(parameter.get_help_record(ctx))) is not None:
                panels[getattr(parameter, "rich_help_panel", None) or ""].append(record)
        left_out: list[str] = []
        for panel in reversed(_PANELS[1:]):
            if Command.shows_all or sum(map(len, panels.values())) <= _MOST_SHOWN:
                break
            if panels.pop(panel):
                left_out.insert(0, panel.lower())
        for title, records in {"Arguments": arguments, "Options": panels.pop(""), **panels}.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)
        if left_out:
            formatter.write_paragraph()
            formatter.write_text(f"More options ({'; '.join(left_out)}): {ctx.command_path} --help-all")

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        """Check the outputs, then run. Raises UsageError if an output cannot be written to."""
        assert self.callback is not None
        use_built_in(ctx)
        outputs.check_all(inspect.unwrap(self.callback), ctx.params)
        return super().invoke(ctx)


class Group(TyperGroup):
    """The commands, which help lists by group."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands under the titles of their groups."""
        for title, names in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, self.commands[name].get_short_help_str(80)) for name in names])


class Application(typer.Typer):
    """The Typer application."""

    def only(self, command: str | None) -> Any:
        """Return the Click group of one command.

        For an unknown name, it is a group that lists the names of all commands with their one-line helps.
        """
        known = [command] if command in COMMANDS else []
        load(known)
        chosen = copy(self)
        chosen.registered_commands = [each for each in self.registered_commands if each.name in known]
        group: Any = typer.main.get_command(chosen)
        if not known:
            group.commands = {
                name: TyperCommand(name, short_help=line) for name, (_, line) in COMMANDS.items()
            }
        return group

    def command(self, name: str, **kwargs: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:  # type: ignore[override]
        """Add a command, see `typer.Typer.command`; a parameter may be a dataclass of options, see `load`."""
        return super().command(name, cls=Command, short_help=COMMANDS[name][1], **kwargs)


def with_groups(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return the command with each parameter that is a dataclass of options replaced by its fields."""
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, Any] = {
        p.name: p.annotation for p in signature.parameters.values() if is_dataclass(p.annotation)
    }
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


def _without_range(record: tuple[str, str] | None) -> tuple[str, str] | None:
    """Return an option's line of a help without its range of numbers, which its error states."""
    if record is None:
        return None
    names, text = record
    return names, _RANGE.sub(lambda found: "]" if found[1] == "; " else "", text)


app = Application(
    name="manifold",
    cls=Group,
    help="Estimate whole BRDFs from few measurements, predict materials between measured ones, render and export them.",
    epilog="Start with `manifold demo`, which runs all main steps on built-in materials.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
