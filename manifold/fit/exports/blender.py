"""Blender's Principled BSDF (4.0 and later): values of its sockets, a script that sets them, and Cycles' BRDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from manifold.core.records import Array
from manifold.fit.exports import lobes, openpbr
from manifold.fit.exports.document import Export, Parameter, defaults, tint_parameter
from manifold.fit.exports.lobes import ShadingPairs, per_pairs, zeltner_layer
from manifold.fit.exports.principled_values import PrincipledValues, ior_to_f0
from manifold.fit.exports.targets import FLAKES, Target
from manifold.fit.exports.thin_film import film_over_f82, film_over_index_cycles

PARAMETERS = {
    "Base Color": Parameter([0.8, 0.8, 0.8], is_free=True),
    "Metallic": Parameter(0.0, is_free=True),
    "Roughness": Parameter(0.5, is_free=True, low=0.02),
    "IOR": Parameter(1.5, is_free=True, low=1.0, high=2.0),
    "Specular IOR Level": Parameter(0.5),
    "Specular Tint": tint_parameter(),
    "Anisotropic": Parameter(0.0),
    "Anisotropic Rotation": Parameter(0.0),
    "Coat Weight": Parameter(0.0, is_free=True),
    "Coat Roughness": Parameter(0.03, is_free=True, low=0.02),
    "Coat IOR": Parameter(1.5, low=1.0, high=2.0),
    "Sheen Weight": Parameter(0.0, is_free=True),
    "Sheen Roughness": Parameter(0.5, is_free=True, low=openpbr.FUZZ_ROUGHNESS),
    "Sheen Tint": Parameter([1.0, 1.0, 1.0]),
    "Thin Film Thickness": Parameter(0.0, low=50.0, high=1200.0),
    "Thin Film IOR": Parameter(1.33, low=1.0, high=2.5),
}
"""Sockets that exports may set; colours have no alpha."""

DEFAULTS = defaults(PARAMETERS)

BASE_COLOUR = "Base Color"
COAT = ("Coat Weight", "Coat Roughness")
SHEEN = ("Sheen Weight", "Sheen Tint", "Sheen Roughness")
FILM = ("Thin Film Thickness", "Thin Film IOR")

_SCRIPT = '''"""{sentence}

Run in Blender's text editor, or: blender FILE.blend --python THIS. It creates the material or changes the one of its
name, and keeps it where no object uses it yet; save the file afterwards. Colours are scene-linear Rec. 709.
"""

import bpy

if bpy.app.version < (4, 0, 0):  # its Principled BSDF has other sockets
    raise RuntimeError("this material needs Blender 4.0 or later, found " + bpy.app.version_string)

NAME = {name}
VALUES = {values}
if VALUES["Thin Film Thickness"] and bpy.app.version < (5, 0, 0):  # its metals have no film
    raise RuntimeError("the thin film of this material needs Blender 5.0 or later, found " + bpy.app.version_string)

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
    if key.startswith("Thin Film") and key not in shader.inputs:  # Blender 4.0 and 4.1
        continue
    for link in shader.inputs[key].links:  # of a texture, whose value would be taken
        material.node_tree.links.remove(link)
    shader.inputs[key].default_value = (*value, 1.0) if isinstance(value, list) else value
'''
_TEXTURED = """
from pathlib import Path

FOLDER = Path(__file__).parent if "__file__" in globals() else Path(bpy.path.abspath("//"))  # of the pictures


def picture(name, space):
    node = next((n for n in nodes if n.type == "TEX_IMAGE" and n.label == name), None)
    node = node or nodes.new("ShaderNodeTexImage")
    node.label, node.image = name, bpy.data.images.load(str(FOLDER / name), check_existing=True)
    node.image.colorspace_settings.name = space
    return node


def bump(name, socket):
    node = next((n for n in nodes if n.type == "NORMAL_MAP" and n.label == socket), None)
    node = node or nodes.new("ShaderNodeNormalMap")
    node.label = socket
    links.new(picture(name, "Non-Color").outputs["Color"], node.inputs["Color"])
    links.new(node.outputs["Normal"], shader.inputs[socket])


links = material.node_tree.links
links.new(picture({base_colour}, "sRGB").outputs["Color"], shader.inputs["Base Color"])
bump({normal}, "Normal")
"""
_COATED = """bump({coat_normal}, "Coat Normal")
parts = next((n for n in nodes if n.type == "SEPARATE_COLOR"), None) or nodes.new("ShaderNodeSeparateColor")
links.new(picture({coat}, "Non-Color").outputs["Color"], parts.inputs["Color"])
links.new(parts.outputs["Red"], shader.inputs["Coat Weight"])
links.new(parts.outputs["Green"], shader.inputs["Coat Roughness"])
"""
_NAME_BYTES = 63  # that Blender 4 keeps of a name; with more, a script would not find its material again


def parameters(material: PrincipledValues) -> dict[str, Any]:
    """Return the values of all sockets in `DEFAULTS`; the sheen is Zeltner's model, as in OpenPBR's fuzz."""
    made = DEFAULTS | {
        "Base Color": list(material.base_color),
        "Metallic": material.metallic,
        "Roughness": material.roughness,
        "IOR": material.ior,
        "Specular IOR Level": 0.0 if material.is_diffuse else 0.5,
        "Anisotropic": material.anisotropic,
        "Anisotropic Rotation": material.rotation_rad / (2.0 * np.pi),
    }
    if material.metallic == 0.0:  # for metals it is the edge's colour
        made["Specular Tint"] = np.clip(material.specular_tint, 0.0, 1.0).tolist()
    made |= material.scaled_sheen(*SHEEN, openpbr.FUZZ_SCALE, openpbr.FUZZ_ROUGHNESS)
    return made | material.coat(*COAT)


def script(export: Export) -> str:
    """Return a Python script for Blender that creates or changes the material."""
    values = "{\n" + "".join(f"    {k!r}: {v!r},\n" for k, v in export.parameters.items()) + "}"
    sentence = export.sentence().replace("\\", "/").replace('"', "'")
    name = export.label.encode()[:_NAME_BYTES].decode(errors="ignore")
    made = _SCRIPT.format(sentence=sentence, name=repr(name), values=values)
    if export.textures is not None:
        names = {key: repr(path.name) for key, path in export.textures.named.items()}
        made += (_TEXTURED + _COATED * (export.textures.coat is not None)).format(**names)
    return made


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF in Cycles, f in 1/sr, shape (P, 3).

    Args:
        values: values of all sockets in `DEFAULTS`; the distribution is Multiscatter GGX.
        pairs: P direction pairs.

    The BRDF below a layer is scaled by one minus the layer's albedo towards the viewer.

    Source: Blender's manual, Principled BSDF, and Cycles 5.0 (svm/closure.h, bsdf_microfacet.h).
    """
    pairs = pairs.turned(2.0 * np.pi * values["Anisotropic Rotation"])
    base, tint, m = np.asarray(values["Base Color"]), np.asarray(values["Specular Tint"]), values["Metallic"]
    aspect = float(np.sqrt(1.0 - 0.9 * values["Anisotropic"]))
    alpha_x, alpha_y = min(values["Roughness"] ** 2 / aspect, 1.0), values["Roughness"] ** 2 * aspect
    f0 = min(2.0 * values["Specular IOR Level"] * ior_to_f0(values["IOR"]), 0.99)
    f: Array = np.broadcast_to(base / np.pi, (len(pairs.view), 3))
    thickness_nm, film_ior = (values[name] for name in FILM)
    film = (film_ior, thickness_nm) if thickness_nm else None
    if f0 > 0.0 or film is not None:
        ior = 2.0 / (1.0 - float(np.sqrt(f0))) - 1.0
        f = _interface(pairs, f, ior, alpha_x, alpha_y, tint=tint, film=film)
    if m:
        fresnel = lobes.fresnel_f82(base, np.minimum(tint, 1.0), pairs.cos_d)
        if film is not None:
            fresnel = _metal_film(pairs, *film, base, np.minimum(tint, 1.0))
        mean = lobes.mean_f82(base, np.minimum(tint, 1.0))
        scattered, _ = _scattered(pairs, mean, alpha_x, alpha_y)
        f = (1.0 - m) * f + m * lobes.specular_joint(pairs, alpha_x, alpha_y)[:, None] * fresnel * scattered
    if values["Coat Weight"]:
        alpha = values["Coat Roughness"] ** 2
        f = _interface(pairs, f, values["Coat IOR"], alpha, alpha, weight=values["Coat Weight"])
    return zeltner_layer(
        pairs, f, values["Sheen Weight"], np.asarray(values["Sheen Tint"]), values["Sheen Roughness"]
    )


def _interface(
    pairs: ShadingPairs, below: Array, ior: float, alpha_x: float, alpha_y: float, *, weight: float = 1.0,
    tint: Array | float = 1.0, film: tuple[float, float] | None = None,
) -> Array:  # fmt: skip
    """Return a rough dielectric over a BRDF `below` (P, 3), tinted along the normal.

    `film` is its index and thickness in nm.
    """
    real = ior_to_f0(ior)
    f0 = np.clip(real * np.atleast_1d(tint), 0.0, 1.0)

    def between(share: Array | float) -> Array:
        return f0 + (1.0 - f0) * share

    def filmed(found: Array) -> Array:
        tinted = np.clip((1.0 - found) / (1.0 - real), 0.0, 1.0)  # less towards grazing
        return found * (1.0 + tinted * (f0 / real - 1.0)) if real > 1e-5 else found

    mean = between(max((lobes.mean_dielectric(ior) - real) / (1.0 - real), 0.0))
    scattered, single = _scattered(pairs, mean, alpha_x, alpha_y)
    fresnel: Array
    albedo: Array
    if film is None:
        fresnel = between((lobes.dielectric_fresnel(pairs, ior) - real) / (1.0 - real))
        share = lobes.dielectric_share(pairs, float(np.sqrt(alpha_x * alpha_y)), ior)[:, None]
        albedo = between(share) * scattered * single
    else:  # its albedo is taken as a mirror's
        fresnel, albedo = map(filmed, _dielectric_films(pairs, *film, ior))
    most = reduce(np.maximum, albedo.T)[:, None]
    lobe = lobes.specular_joint(pairs, alpha_x, alpha_y)[:, None] * fresnel * scattered
    return weight * lobe + (1.0 - weight * most) * below


@per_pairs
def _dielectric_films(
    pairs: ShadingPairs, film_ior: float, thickness_nm: float, ior: float
) -> tuple[Array, Array]:
    """Return the reflectance of a film at the half vector, and at the normal, (P, 3) each."""
    at_half, at_normal = (
        film_over_index_cycles(film_ior, thickness_nm, ior, cosine) for cosine in (pairs.cos_d, pairs.cos_v)
    )
    return at_half, at_normal


@per_pairs
def _metal_film(pairs: ShadingPairs, film_ior: float, thickness_nm: float, f0: Array, edge: Array) -> Array:
    return film_over_f82(film_ior, thickness_nm, f0, edge, pairs.cos_d)


def _scattered(pairs: ShadingPairs, mean: Array, alpha_x: float, alpha_y: float) -> tuple[Array, Array]:
    """Return the factor for light scattered between facets of mean reflectance (3,), and the albedo without Fresnel."""
    single, average = lobes.single_scattering(pairs, float(np.sqrt(alpha_x * alpha_y)))
    multiple = mean * average / (1.0 - mean * (1.0 - average))
    return 1.0 + multiple * (1.0 - single) / single, single


BLENDER = Target(
    name="blender",
    suffix=".py",
    title="Blender 4 and later, Principled BSDF, a script",
    entries=PARAMETERS,
    parameters=parameters,
    brdf=brdf,
    content=lambda export: script(export).encode(),
    base_colour=BASE_COLOUR,
    coat=COAT,
    sheen=SHEEN,
    film=FILM,
    textures=FLAKES,
)

_CONVENTIONS = {
    "Base Color": "scene-linear Rec. 709 (sRGB primaries), 0 to 1",
    "Roughness": "0 to 1; GGX alpha is its square; Coat Roughness alike",
    "IOR": "of the surface; Specular IOR Level 0.5 leaves its reflectance as it is",
}

BLENDER_JSON = replace(
    BLENDER,
    name="blender-json",
    suffix=".json",
    title="Blender 4 and later, Principled BSDF, values",
    content=lambda export: export.json_file(_CONVENTIONS),
    textures=(),
)
