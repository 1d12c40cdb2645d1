"""Generates the code of a shader: GLSL with the numbers of a table, and its translations to HLSL and Metal."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from manifold import __version__
from manifold.core.errors import UsageError
from manifold.shader.table import ShaderTable

_COMPILERS = ("glslangValidator", "glslang")  # of Debian and older packages; of newer ones
_LANGUAGES = {"hlsl": ("--hlsl", "--shader-model", "50"), "metal": ("--msl",)}
ENTRY = "manifold_example"
"""Name of the entry point of translations, which shows how to call the functions."""
_WRAPPER = """#version 310 es
precision highp float;
precision highp int;
layout(binding = 0) uniform highp sampler2D manifold_table;
#define MANIFOLD_TABLE manifold_table
@CODE@
layout(location = 0) in vec3 manifold_wi;
layout(location = 1) in vec3 manifold_wo;
layout(location = 2) in vec2 manifold_u;
layout(location = 0) out vec4 manifold_result;

void main() {
  vec4 drawn = manifold_sample(manifold_u, manifold_wi);
  vec3 weight = drawn.w > 0.0 ? manifold_eval(manifold_wi, drawn.xyz) / drawn.w : vec3(0.0);
  manifold_result = vec4(manifold_eval(manifold_wi, manifold_wo) + weight, manifold_pdf(manifold_wi, manifold_wo));
}
"""
_TIMEOUT_S = 60.0


class Translations(NamedTuple):
    """Translated code by file suffix, and a note if there are no translations."""

    code: dict[str, str]
    note: str | None = None


def glsl(table: ShaderTable, name: str) -> str:
    """Return the GLSL code for a table; `name` appears in its first comment."""
    text = files("manifold.shader").joinpath("manifold.glsl").read_text(encoding="utf-8")
    head = f"{' '.join(name.split())}, by manifold {__version__}"
    return text.replace("@NAME@", head).replace("@CONSTANTS@", _constants(table))


def renamed(text: str, prefix: str | None) -> str:
    """Return the code with the prefix `manifold` of functions and constants replaced; None keeps it."""
    if prefix is None:
        return text
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", prefix) or prefix.startswith("gl_"):
        raise UsageError(
            f"prefix '{prefix}', expected a name of letters, digits and single underscores, such as copper"
        )
    for name, new in (("MANIFOLD", prefix.upper()), ("manifold", prefix)):
        text = re.sub(rf"(?<![A-Za-z0-9])(_*){name}_", rf"\g<1>{new}_", text)
    return text


def _constants(table: ShaderTable) -> str:
    shape, lobes = table.shape, table.lobes
    T = shape.incidences
    weights = ", ".join(f"vec3({_numbers(row)})" for row in lobes.weights)
    return "\n".join([
        f"const int MANIFOLD_INCIDENCES = {T};",
        f"const float MANIFOLD_THETA[{T}] = float[{T}]({_numbers(table.theta_i_rad)});",
        f"const ivec2 MANIFOLD_SIZE = ivec2({shape.width}, {shape.height});",
        f"const ivec2 MANIFOLD_SUMS = ivec2({shape.columns}, {shape.rows});",
        f"const ivec2 MANIFOLD_VALUES = ivec2({shape.values}, {shape.values});",
        f"const int MANIFOLD_VALUE_ROW = {shape.first_value_row};",
        f"const int MANIFOLD_NORMAL_ROW = {shape.normal_row};",
        f"const int MANIFOLD_NODES = {shape.nodes};",
        f"const float MANIFOLD_FACTOR = {table.factor:.9e};",
        f"const vec2 MANIFOLD_ALPHAS = vec2({_numbers(lobes.alphas)});",
        f"const vec3 MANIFOLD_WEIGHTS[{T}] = vec3[{T}]({weights});",
    ])  # fmt: skip


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.9e}" for value in values)


def translated(code: str) -> Translations:
    """Translate GLSL to HLSL (shader model 5) and Metal, by glslang and SPIRV-Cross if these are installed."""
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    converter = shutil.which("spirv-cross")
    if compiler is None or converter is None:
        missing = " and ".join(
            name for name, found in (("glslang", compiler), ("spirv-cross", converter)) if found is None
        )
        return Translations({}, f"{missing} not found: GLSL only, no HLSL or Metal; on Debian, apt-get install "
                            "glslang-tools spirv-cross")  # fmt: skip
    with TemporaryDirectory() as folder:
        source, binary = Path(folder) / "shader.frag", Path(folder) / "shader.spv"
        source.write_text(_WRAPPER.replace("@CODE@", code), encoding="utf-8")
        steps = [[compiler, "-V", "-S", "frag", "-o", str(binary), str(source)]]
        rename = ["--rename-entry-point", "main", ENTRY, "frag"]
        outputs = {suffix: Path(folder) / f"shader.{suffix}" for suffix in _LANGUAGES}
        steps += [
            [converter, str(binary), *_LANGUAGES[suffix], *rename, "--output", str(path)]
            for suffix, path in outputs.items()
        ]
        for step in steps:
            done = subprocess.run(step, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
            if done.returncode:
                reason = " ".join((done.stdout + done.stderr).split())[:200]
                return Translations(
                    {}, f"{Path(step[0]).name} failed: GLSL only, no HLSL or Metal ({reason})"
                )
        head = "\n".join(line for line in code.splitlines()[:1])
        return Translations({
            suffix: f"{head}\n// Translated from manifold.glsl by glslang and SPIRV-Cross; {ENTRY} shows the calls.\n"
            + path.read_text(encoding="utf-8")
            for suffix, path in outputs.items()
        })  # fmt: skip
