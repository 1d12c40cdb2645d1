"""Readers of exported files: the parameters and meshes that they hold."""

from __future__ import annotations

import ast
import json
import struct
import xml.etree.ElementTree as ET

import numpy as np

from manifold.fit.exports import gltf
from manifold.fit.exports.materialx import NODES


def read_glb(path):
    """The JSON and the binary chunk of a `.glb`."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    chunks, at = {}, 12
    while at < length:
        size, kind = struct.unpack_from("<I4s", content, at)
        chunks[kind] = content[at + 8 : at + 8 + size]
        at += 8 + size
    return json.loads(chunks[b"JSON"]), chunks.get(b"BIN\0", b"")


def accessor_values(document, content, index):
    """The values of an accessor of a `.glb`, shape (count, components)."""
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    kind = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    offset = view["byteOffset"] + accessor.get("byteOffset", 0)
    return np.frombuffer(content, kind, accessor["count"] * width, offset).reshape(-1, width)


def gltf_parameters(material):
    """The parameters of a material of glTF."""
    made = gltf.DEFAULTS | material.get("pbrMetallicRoughness", {})
    made["baseColorFactor"] = made["baseColorFactor"][:3]
    for entries in material.get("extensions", {}).values():
        made |= entries
    return made


def materialx_parameters(path, target):
    """The parameters of a MaterialX document."""
    category, defaults = NODES[target]
    made, root = dict(defaults), ET.parse(path).getroot()
    for entry in root.find(category).findall("input"):
        if entry.get("nodename"):
            (node,) = root.findall(f"rotate3d[@name='{entry.get('nodename')}']")
            made[entry.get("name")] = -float(node.find("input[@name='amount']").get("value"))
            continue
        values = [float(v) for v in entry.get("value").split(",")]
        made[entry.get("name")] = values if entry.get("type") == "color3" else values[0]
    return made


def blender_parameters(text):
    """The values that a script for Blender sets."""
    (values,) = (
        node.value
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "VALUES"
    )
    return ast.literal_eval(values)
