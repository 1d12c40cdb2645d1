"""Blender's Principled BSDF (4.0 and later) as values of its sockets, as JSON and as a script that sets them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from manifold.fitting.exports import openpbr
from manifold.fitting.exports.document import Export
from manifold.fitting.exports.principled_values import Principled

DEFAULTS: dict[str, Any] = {
    "Base Color": [0.8, 0.8, 0.8],
    "Metallic": 0.0,
    "Roughness": 0.5,
    "IOR": 1.5,
    "Specular IOR Level": 0.5,
    "Specular Tint": [1.0, 1.0, 1.0],
    "Anisotropic": 0.0,
    "Coat Weight": 0.0,
    "Coat Roughness": 0.03,
    "Coat IOR": 1.5,
    "Sheen Weight": 0.0,
    "Sheen Roughness": 0.5,
    "Sheen Tint": [1.0, 1.0, 1.0],
}
"""Every socket that exports may set, with its default; colours without alpha."""

_SCRIPT = '''"""{sentence}

Run in Blender's text editor, or: blender FILE.blend --python THIS. It creates the material or changes the one of its
name, and keeps it where no object uses it yet; save the file afterwards. Colours are scene-linear Rec. 709.
"""

import bpy

if bpy.app.version < (4, 0, 0):  # its Principled BSDF has other sockets
    raise RuntimeError("this material needs Blender 4.0 or later, found " + bpy.app.version_string)

NAME = {name}
VALUES = {values}

material = bpy.data.materials.get(NAME) or bpy.data.materials.new(NAME)
material.use_fake_user = True
if bpy.app.version < (5, 0, 0):  # later, materials always have nodes
    material.use_nodes = True
nodes = material.node_tree.nodes
shader = next((n for n in nodes if n.type == "BSDF_PRINCIPLED"), None)
if shader is None:
    shader = nodes.new("ShaderNodeBsdfPrincipled")
    output = next((n for n in nodes if n.type == "OUTPUT_MATERIAL"), None) or nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
shader.distribution = "MULTI_GGX"
for key, value in VALUES.items():
    shader.inputs[key].default_value = (*value, 1.0) if isinstance(value, list) else value
'''
_NAME_BYTES = 63  # that Blender 4 keeps of a name; with more, a script would not find its material again


def parameters(material: Principled) -> dict[str, Any]:
    """Values of the sockets, all of `DEFAULTS`. Sheen is Zeltner's, as OpenPBR's fuzz."""
    made = DEFAULTS | {
        "Base Color": list(material.base_color),
        "Metallic": material.metallic,
        "Roughness": material.roughness,
        "IOR": material.ior,
        "Specular IOR Level": 0.0 if material.is_diffuse else 0.5,
        "Anisotropic": material.anisotropic,
    }
    if material.metallic == 0.0:  # for metals it is the edge's colour
        made["Specular Tint"] = np.clip(material.specular_tint, 0.0, 1.0).tolist()
    if material.coat_weight > 0.0:
        made["Coat Weight"] = material.coat_weight
        made["Coat Roughness"] = material.coat_roughness
    if np.any(material.sheen_colour > 0.0):
        made["Sheen Weight"], made["Sheen Tint"] = material.scaled_sheen(openpbr.FUZZ_SCALE)
        made["Sheen Roughness"] = openpbr.FUZZ_ROUGHNESS
    return made


def script(export: Export) -> str:
    """Python for Blender that makes or changes the material of this name."""
    values = "{\n" + "".join(f"    {k!r}: {v!r},\n" for k, v in export.parameters.items()) + "}"
    sentence = export.sentence().replace("\\", "/").replace('"', "'")
    name = export.label.encode()[:_NAME_BYTES].decode(errors="ignore")
    return _SCRIPT.format(sentence=sentence, name=repr(name), values=values)


def read_script(text: str) -> dict[str, Any]:
    """The values that a script of `script` sets."""
    import ast

    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "VALUES":
            return ast.literal_eval(node.value)
    return {}


def document(export: Export) -> str:
    """The same as JSON."""
    return json.dumps(export.to_json(), indent=2, allow_nan=False) + "\n"
