"""Balls and planes in Cycles, for a Python interpreter that has Blender's `bpy`; run by text, with a task in JSON.

Pictures are linear, RGBA, rows from below. World: z up, radii of the ball; a white diffuser that faces a sun has the
radiance 1. Environments are arrays (H, 2 H) of grey radiance in Blender's layout, see `balls.layout`.
"""

import json
import math
import os
import sys
from pathlib import Path

import bpy
import mathutils
import numpy as np

task = json.loads(sys.argv[1])


def turned(towards):
    """Angles at which what looks along -z looks from a direction to the origin."""
    return mathutils.Vector(towards).to_track_quat("Z", "Y").to_euler()


def material_of(path):
    """The one material of a script of ours, or of a glTF or USD file as Blender imports it."""
    before = set(bpy.data.materials)
    if path.endswith((".glb", ".usda")):
        if path.endswith(".glb"):
            bpy.ops.import_scene.gltf(filepath=path)
        else:
            bpy.ops.wm.usd_import(filepath=path, import_all_materials=True)
        for thing in [t for t in bpy.data.objects if t.name not in ("drawn", "camera", "sun")]:
            bpy.data.objects.remove(thing)
    else:
        text = Path(path).read_text(encoding="utf-8")
        exec(compile(text, path, "exec"), {"__name__": "__main__", "__file__": path})
    (made,) = set(bpy.data.materials) - before
    return made


def light(scene, sun, described):
    """Set a sun's direction or the radiance of the surroundings; how many samples a pixel needs."""
    tree = scene.world.node_tree
    tree.nodes.clear()
    background = tree.nodes.new("ShaderNodeBackground")
    tree.links.new(background.outputs[0], tree.nodes.new("ShaderNodeOutputWorld").inputs["Surface"])
    is_sun = isinstance(described, list)
    sun.hide_render = not is_sun
    background.inputs["Strength"].default_value = 0.0 if is_sun else 1.0
    if is_sun:
        sun.rotation_euler = turned(described)
        return task["samples"][0]
    radiance = np.load(described).astype(np.float32)[::-1]  # rows from below
    image = bpy.data.images.new("surroundings", radiance.shape[1], radiance.shape[0], float_buffer=True)
    image.colorspace_settings.is_data = True
    image.pixels.foreach_set(np.repeat(radiance[..., None], 4, axis=2).ravel())
    picture = tree.nodes.new("ShaderNodeTexEnvironment")
    picture.image = image
    tree.links.new(picture.outputs["Color"], background.inputs["Color"])
    return task["samples"][1]


bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("world")
if not scene.world.node_tree:
    scene.world.use_nodes = True
scene.render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
scene.cycles.max_bounces = 1
scene.cycles.pixel_filter_type = "BOX"
scene.cycles.filter_width = task["filter"]  # of pixels
scene.render.threads_mode, scene.render.threads = "FIXED", 2
scene.render.resolution_x = scene.render.resolution_y = task["size"]
scene.render.film_transparent = True
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
scene.render.filepath = task["folder"] + "/picture.exr"
if task["shape"] == "plane":
    bpy.ops.mesh.primitive_plane_add(size=2.0)
else:
    bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128)
    bpy.ops.object.shade_smooth()
drawn = bpy.context.object
drawn.name = "drawn"
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0 * task["edge"]
camera.location = 20.0 * mathutils.Vector(task["view"])
if task["shape"] == "ball":  # planes are seen from above, with y up
    camera.rotation_euler = turned(task["view"])
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.data.angle = math.pi, 0.0
for thing in (camera, sun):
    scene.collection.objects.link(thing)
scene.camera = camera
for name, path in task["materials"].items():
    material = material_of(path)
    drawn.data.materials.clear()
    drawn.data.materials.append(material)
    for key, described in task["lights"].items():
        scene.cycles.samples = light(scene, sun, described)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.is_data = True
        pixels = np.empty(4 * task["size"] ** 2, np.float32)
        image.pixels.foreach_get(pixels)
        np.save(f"{task['folder']}/{name} {key}.npy", pixels.reshape(task["size"], task["size"], 4))
        bpy.data.images.remove(image)
    bpy.data.materials.remove(material)
print(json.dumps(bpy.app.version_string))
sys.stdout.flush()
os._exit(0)  # Blender may crash as it ends
