"""Blender itself, run by the Python interpreter that MANIFOLD_BLENDER_PYTHON names: one that has the module bpy."""

from __future__ import annotations

import json
import os
import subprocess
from typing import Any

import pytest

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

BALLS = """
import json, math, sys
import bpy, mathutils
import numpy as np
task = json.loads(sys.argv[1])
bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.samples = 1
scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
scene.cycles.max_bounces = 0
scene.cycles.pixel_filter_type = "BOX"
scene.cycles.filter_width = 0.01  # a pixel is its centre
scene.render.threads_mode, scene.render.threads = "FIXED", 2
scene.render.resolution_x = scene.render.resolution_y = task["size"]
scene.render.film_transparent = True
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
scene.render.filepath = task["picture"]
bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128)
ball = bpy.context.object
bpy.ops.object.shade_smooth()

def turned(towards):
    return mathutils.Vector(towards).to_track_quat("Z", "Y").to_euler()

camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0 * task["edge"]
camera.location, camera.rotation_euler = 20.0 * mathutils.Vector(task["view"]), turned(task["view"])
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.data.angle = math.pi, 0.0  # white diffusers that face it have radiance 1
sun.rotation_euler = turned(task["light"])
for thing in (camera, sun):
    scene.collection.objects.link(thing)
scene.camera = camera
found = {}
for path in task["scripts"]:
    exec(compile(open(path, encoding="utf-8").read(), path, "exec"), {"__name__": "__main__"})
    ball.data.materials.clear()
    ball.data.materials.append(bpy.data.materials[-1])
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(task["picture"])
    image.colorspace_settings.is_data = True
    pixels = np.empty(4 * task["size"] ** 2, np.float32)
    image.pixels.foreach_get(pixels)
    found[path] = pixels.tolist()
    bpy.data.images.remove(image)
    bpy.data.materials.remove(bpy.data.materials[-1])
print(json.dumps(found))
"""
"""Renders balls of scripts' materials under a distant light in Cycles; prints RGBA, rows from below."""


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
