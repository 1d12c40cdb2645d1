"""Selects the library and model for commands without such options: the user's own, otherwise the built-in ones."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from manifold.core import shipped

from . import terminal

DEFAULT_LIBRARY = Path("library.zarr")
DEFAULT_MODEL = Path("model.h5")
_WRITERS = ("import", "compact", "embed")
"""Commands that make or change a library or a model, which is always the user's."""


def use_built_in(context: Any) -> None:
    """Use the built-in library and model if none is given and the default paths do not exist.

    A message on stderr says so when one is opened. If the built-in library is given, the built-in model is used with
    it. A given model is used with its own library.
    """
    values, name = context.params, context.command.name
    if name in _WRITERS or not {"library", "model"} & values.keys():
        return
    is_named = any(isinstance(v, str | Path) and shipped.is_built_in(v) for v in values.values())
    given = {key for key in values if context.get_parameter_source(key).name != "DEFAULT"}
    is_default = not given & {"library", "model"} and not (DEFAULT_LIBRARY.exists() or DEFAULT_MODEL.exists())
    goes_with = "library" in given and shipped.is_built_in(values["library"]) and not DEFAULT_MODEL.exists()
    is_inspected = name == "info" and "path" in given  # a model names its own library
    if "model" in given and "library" not in given and values.get("library") == DEFAULT_LIBRARY:
        from manifold.model.manifold import load_model

        values["library"] = load_model(values["model"], None).library.path
    if is_default and "library" in values and not is_inspected:
        values["library"] = shipped.BUILT_IN
    if (is_default or goes_with) and "model" not in given and values.get("model") is not None:
        values["model"] = shipped.BUILT_IN
    if is_default and name == "info" and not is_inspected:
        values["path"] = shipped.BUILT_IN.name
    shipped.tell_with(partial(terminal.note_built_in, is_default=is_default and not is_named))
