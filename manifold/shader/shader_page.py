"""Makes the page of a shader, one file that shows the balls of source and shader under interactive light."""

from __future__ import annotations

import base64
from importlib.resources import files
from typing import Any

import numpy as np

from manifold.colour.lights import ENVIRONMENTS, environment
from manifold.core.judged_lights import BALL
from manifold.page.page import fill_page, joined_modules
from manifold.shader import code
from manifold.shader.table import ShaderTable

_ENVIRONMENT_ROWS = 64  # 2.8 degrees a texel: finer ones would be noise of the samples
_MODULES = ("colour", "webgl", "difference")


def make_page(
    layout: dict[str, Any], glsl: str, table: ShaderTable, reference: tuple[ShaderTable, float]
) -> str:
    """Return an HTML page that shows the balls of a material and of its shader.

    `layout` is the content of the layout's JSON file. `reference` holds a finer table, which is drawn in place of the
    material, and the error of that table.
    """
    errors, finer = layout["errors"], reference[0]
    document = {
        "name": layout["material"],
        "facts": (
            f"{errors['ball']:.2f} {BALL}, {errors['worst']:.2f} in {errors['worst_light']}, against the "
            f"{layout['against']}; {layout['bytes'] / 1000:.0f} kB; "
            f"{layout['fetches']['eval']} texture reads per evaluation"
        ),
        "source": f"Source, by a table within {reference[1]:.2f} of the {layout['against']}",
        "notes": layout["notes"],
        "shader": {"code": glsl, "table": _halves(table.texels)},
        "reference": {"code": code.glsl(finer, layout["material"]), "table": _halves(finer.texels)},
        "environments": [
            {"name": name} | _halves(environment(name, _ENVIRONMENT_ROWS).astype(np.float16))
            for name in ENVIRONMENTS
        ],
    }
    script = joined_modules(_MODULES, _text("shader.js"))
    return fill_page(_text("shader.html"), script, _text("shader.css"), document)


def _text(name: str) -> str:
    return files("manifold.shader").joinpath(name).read_text(encoding="utf-8")


def _halves(values: Any) -> dict[str, Any]:
    height, width, channels = values.shape
    text = base64.b64encode(values.astype("<f2").tobytes()).decode("ascii")
    return {"width": width, "height": height, "channels": channels, "halves": text}
