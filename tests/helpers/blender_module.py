"""Blender itself, run by the Python interpreter that MANIFOLD_BLENDER_PYTHON names: one that has the module bpy."""

from __future__ import annotations

import json
import os
import subprocess
from typing import Any

import pytest
from helpers.paths import REPOSITORY

VARIABLE = "MANIFOLD_BLENDER_PYTHON"

SCRIPTS = """
import json, sys, warnings
import bpy
warnings.simplefilter("error")  # what Blender is about to remove
found = {}
for path in json.loads(sys.argv[1]):
    bpy.ops.wm.read_homefile(use_empty=True)
    for _ in range(2):
        text = bpy.data.texts.load(path)
        exec(compile(text.as_string(), text.name, "exec"), {"__name__": "__main__"})
    materials = {}
    for material in bpy.data.materials:
        (shader,) = [n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"]
        sockets = [s for s in shader.inputs if hasattr(s, "default_value") and not s.is_linked]
        values = {s.name: s.default_value for s in sockets}
        values = {k: list(v) if hasattr(v, "__len__") else v for k, v in values.items()}
        output = material.node_tree.get_output_node("ALL")
        is_connected = output.inputs["Surface"].links[0].from_node == shader
        materials[material.name] = [values, shader.distribution, is_connected, material.use_fake_user]
    found[path] = materials
print(json.dumps(found))
"""
"""Runs scripts twice each, as the text editor does; prints the materials of each and their sockets."""

IMPORTS = """
import json, sys
import bpy
found = {}
for path in json.loads(sys.argv[1]):
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path) if path.endswith("glb") else bpy.ops.wm.usd_import(filepath=path)
    (material,) = [m for m in bpy.data.materials if m.users]
    (shader,) = [n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"]
    values = {s.name: s.default_value for s in shader.inputs if hasattr(s, "default_value")}
    values = {k: list(v) if hasattr(v, "__len__") else v for k, v in values.items()}
    found[path] = [material.name, sorted(o.name for o in bpy.data.objects if o.type == "MESH"), values]
print(json.dumps(found))
"""
"""Imports files; prints of each the material's name, the meshes, and the sockets."""

SIZE = 96  # pixels of a side
EDGE = 1.02  # radii of the ball that half the picture's side shows

BALLS = (REPOSITORY / "tools" / "engines" / "cycles.py").read_text(encoding="utf-8")
"""Renders balls of scripts' materials in Cycles into a folder, `MATERIAL LIGHT.npy`: RGBA, rows from below."""


def run(script: str, argument: Any) -> Any:
    """What a script prints last, JSON both ways, or a skipped test where no interpreter is named."""
    python = os.environ.get(VARIABLE)
    if not python:
        pytest.skip(
            f"no Blender: set {VARIABLE} to a Python interpreter with the module bpy (pip install bpy)"
        )
    script += "\nimport os; sys.stdout.flush(); os._exit(0)  # Blender 4.2 may crash as it ends"
    made = subprocess.run(
        [python, "-c", script, json.dumps(argument)], capture_output=True, text=True, check=False, timeout=300
    )
    assert made.returncode == 0, made.stdout[-2000:] + made.stderr[-2000:]
    return json.loads(made.stdout.strip().splitlines()[-1])


def version() -> tuple[int, int]:
    """Major and minor version."""
    major, minor = run("import bpy, json, sys; print(json.dumps(bpy.app.version[:2]))", None)
    return major, minor
