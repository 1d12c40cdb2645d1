"""Writes MaterialX documents (`.mtlx`) of one surface shader and one material."""

from __future__ import annotations

import hashlib
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from manifold.fit.exports import openpbr, openpbr_adobe, standard_surface
from manifold.fit.exports.document import Export, TextureFiles
from manifold.fit.exports.targets import FLAKES, Target

NODES: dict[str, tuple[str, Mapping[str, Any]]] = {
    "openpbr": ("open_pbr_surface", openpbr.DEFAULTS),
    "standard-surface": ("standard_surface", standard_surface.DEFAULTS),
}
"""Category and defaults of the shader node of each target."""

NODES_OF_COAT = {"open_pbr_surface": openpbr.COAT[:2], "standard_surface": standard_surface.COAT}
"""Names of the coat's weight and roughness inputs, by category of shader."""

TURN = ("tangent", "normal", "rotate3d")
"""Nodes that turn the tangent of OpenPBR, which has no parameter for the direction of anisotropy: the first two are the
inputs `in` and `axis` of the third."""

_HASH_DIGITS = 8  # hexadecimal; two of a thousand names agree with a probability of 1e-4


def identifier(name: str) -> str:
    """Return a valid identifier for MaterialX, its shaders and USD; GLSL ES forbids two underscores in a row.

    A name that is no such identifier gets a hash, so that different names get different identifiers.
    """
    made = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    if not re.match(r"[A-Za-z]", made):
        made = f"material_{made}".rstrip("_")
    if made == name:
        return made
    content = name.encode(errors="backslashreplace")  # file names may be no valid UTF-8
    return f"{made}_{hashlib.sha256(content).hexdigest()[:_HASH_DIGITS]}"


def mtlx(export: Export) -> bytes:
    """Return the text of the document, without inputs at their defaults; colours are linear Rec. 709."""
    category, defaults = NODES[export.target]
    name = identifier(export.name)
    # lin_rec709: MaterialX's name of linear colours of Rec. 709 primaries
    root = ET.Element("materialx", version="1.39", colorspace="lin_rec709", doc=export.sentence())
    shader = ET.SubElement(root, category, name=f"{name}_shader", type="surfaceshader")
    placed = {} if export.textures is None else _textured(root, name, export.textures, category)
    values = dict(export.parameters)
    if "coat_weight" in placed and not values["coat_weight"]:
        values["coat_darkening"] = 0.0  # or a coat of flakes alone would darken the base below them
    for key, value in values.items():
        if key in placed:
            continue
        if value != defaults[key] and key == "geometry_tangent":
            nodes = [ET.SubElement(root, kind, name=f"{name}_{kind}", type="vector3") for kind in TURN]
            for node in nodes[:2]:
                ET.SubElement(node, "input", name="space", type="string", value="world")
            for entry, node in zip(("in", "axis"), nodes, strict=False):
                ET.SubElement(nodes[2], "input", name=entry, type="vector3", nodename=node.get("name", ""))
            ET.SubElement(nodes[2], "input", name="amount", type="float", value=_number(-value))  # clockwise
            ET.SubElement(shader, "input", name=key, type="vector3", nodename=nodes[2].get("name", ""))
        elif value != defaults[key]:
            is_colour = isinstance(value, list)
            text = ", ".join(map(_number, value)) if is_colour else _number(value)
            ET.SubElement(shader, "input", name=key, type="color3" if is_colour else "float", value=text)
    for key, (kind, source) in placed.items():
        ET.SubElement(shader, "input", name=key, type=kind, nodename=source)
    material = ET.SubElement(root, "surfacematerial", name=name, type="material")
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"{name}_shader")
    ET.indent(root)
    document: str = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n{document}\n'.encode()


def _textured(
    root: ET.Element, name: str, textures: TextureFiles, category: str
) -> dict[str, tuple[str, str]]:
    """Add nodes of textures; return type and node of the inputs that they feed."""
    colour = ET.SubElement(root, "image", name=f"{name}_base_colour", type="color3")
    ET.SubElement(
        colour,
        "input",
        name="file",
        type="filename",
        value=textures.base_colour.name,
        colorspace="srgb_texture",
    )

    def read(path: Path, node: str) -> None:
        image = ET.SubElement(root, "image", name=node, type="vector3")
        ET.SubElement(image, "input", name="file", type="filename", value=path.name)

    def mapped(path: Path, node: str) -> tuple[str, str]:
        read(path, f"{node}s")
        mapping = ET.SubElement(root, "normalmap", name=node, type="vector3")
        ET.SubElement(mapping, "input", name="in", type="vector3", nodename=f"{node}s")
        return "vector3", node

    prefix = "geometry_" if category == "open_pbr_surface" else ""
    placed = {
        "base_color": ("color3", f"{name}_base_colour"),
        f"{prefix}normal": mapped(textures.normal, f"{name}_normal"),
    }
    if textures.coat is not None and textures.coat_normal is not None:
        read(textures.coat, f"{name}_coats")
        for channel, key in enumerate(NODES_OF_COAT[category]):
            node = ET.SubElement(root, "extract", name=f"{name}_{key}", type="float")
            ET.SubElement(node, "input", name="in", type="vector3", nodename=f"{name}_coats")
            ET.SubElement(node, "input", name="index", type="integer", value=str(channel))
            placed[key] = ("float", f"{name}_{key}")
        placed[f"{prefix}coat_normal"] = mapped(textures.coat_normal, f"{name}_coat_normal")
    return placed


def _number(value: float) -> str:
    return f"{value:.9g}"


OPENPBR = Target(
    name="openpbr",
    suffix=".mtlx",
    title="MaterialX, open_pbr_surface",
    entries=openpbr.PARAMETERS,
    parameters=openpbr.parameters,
    brdf=openpbr.brdf,
    content=mtlx,
    base_colour=openpbr.BASE_COLOUR,
    coat=openpbr.COAT,
    sheen=openpbr.SHEEN,
    film=openpbr.FILM,
    textures=FLAKES,
    implementations={"MaterialX": openpbr.brdf, "openpbr-bsdf": openpbr_adobe.brdf},
)

STANDARD_SURFACE = Target(
    name="standard-surface",
    suffix=".mtlx",
    title="MaterialX, standard_surface",
    entries=standard_surface.PARAMETERS,
    parameters=standard_surface.parameters,
    brdf=standard_surface.brdf,
    content=mtlx,
    base_colour=standard_surface.BASE_COLOUR,
    coat=standard_surface.COAT,
    sheen=standard_surface.SHEEN,
    film=standard_surface.FILM,
    textures=FLAKES,
)
