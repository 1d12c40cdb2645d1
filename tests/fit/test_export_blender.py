"""Exports in Blender itself: its script, what its importers read, and what Cycles renders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import blender_module
from helpers.blender_module import EDGE, SIZE
from test_export_files import MATERIALS, export, written

from manifold.colour import ball_colours
from manifold.colour.conversion import srgb_to_xyz
from manifold.core.directions import normalize
from manifold.fit.exports import blender
from manifold.fit.exports.lobes import ShadingPairs
from manifold.registries import TARGETS

NAMES = ["it's a \"\"\"'''{NAME}\\n %s", "x" * 90, "a\x00b\udc80\n", "é" * 40]
"""That Blender, or a script, could stumble over; a name has at most 63 bytes in Blender 4."""


def known():
    """Names of the materials that this Blender has all of."""
    return [name for name in MATERIALS if name != "film" or blender_module.version() >= (5, 0)]


def scripts(folder):
    """Scripts by path: name and parameters."""
    made = {}
    for name in known():
        path, exported = written(folder, name, "blender")
        made[str(path)] = name, exported.parameters
    for i, name in enumerate(NAMES):
        exported = export(name, "blender", MATERIALS["full"])
        path = folder / f"name_{i}.py"
        path.write_bytes(TARGETS["blender"].content(exported))
        made[str(path)] = name, exported.parameters
    return made


def test_the_script_makes_one_material_and_sets_its_sockets(tmp_path):
    made = scripts(tmp_path)
    found = blender_module.run(blender_module.SCRIPTS, list(made))
    for path, (name, parameters) in made.items():
        ((label, (sockets, distribution, is_connected, is_kept)),) = found[path].items()
        expected = "".join(c if c.isprintable() else "?" for c in name).encode()[:63].decode(errors="ignore")
        assert label == expected
        assert (distribution, is_connected, is_kept) == ("MULTI_GGX", True, True)
        for key, value in parameters.items():
            value = [*value, 1.0] if isinstance(value, list) else value
            assert sockets[key] == pytest.approx(value, abs=1e-6), key


TEXTURED = """
import bpy
old = bpy.data.materials.get("plain") or bpy.data.materials.new("plain")
if not old.node_tree:
    old.use_nodes = True
(shader,) = [n for n in old.node_tree.nodes if n.type == "BSDF_PRINCIPLED"]
colour = old.node_tree.nodes.new("ShaderNodeRGB")
old.node_tree.links.new(colour.outputs["Color"], shader.inputs["Base Color"])
"""


def test_a_material_of_the_name_is_changed_where_textures_set_it(tmp_path):
    path, made = written(tmp_path, "plain", "blender")
    path.write_text(TEXTURED + path.read_text())
    ((sockets, _, is_connected, _),) = blender_module.run(blender_module.SCRIPTS, [str(path)])[
        str(path)
    ].values()
    assert is_connected
    assert sockets["Base Color"] == pytest.approx([*made.parameters["Base Color"], 1.0], abs=1e-6)


def test_a_thin_film_is_refused_by_a_blender_whose_metals_have_none(tmp_path):
    if blender_module.version() >= (5, 0):
        pytest.skip("this Blender has films on metals")
    path, _ = written(tmp_path, "film", "blender")
    with pytest.raises(AssertionError, match=r"needs Blender 5\.0 or later, found 4\."):
        blender_module.run(blender_module.SCRIPTS, [str(path)])


def test_the_defaults_are_blender_s(tmp_path):
    path = tmp_path / "x.py"
    path.write_text(
        "import bpy\nmaterial = bpy.data.materials.get('x') or bpy.data.materials.new('x')\n"
        "if not material.node_tree: material.use_nodes = True"
    )
    ((sockets, *_),) = blender_module.run(blender_module.SCRIPTS, [str(path)])[str(path)].values()
    for key, value in TARGETS["blender"].defaults.items():
        if key.startswith("Thin Film") and key not in sockets:  # Blender 4.0 and 4.1
            continue
        value = [*value, 1.0] if isinstance(value, list) else value
        assert sockets[key] == pytest.approx(value, abs=1e-6), key


def test_a_glb_keeps_its_parameters_when_imported(tmp_path):
    made = {str(path): exported for path, exported in (written(tmp_path, n, "gltf") for n in MATERIALS)}
    found = blender_module.run(blender_module.IMPORTS, list(made))
    for path, exported in made.items():
        name, meshes, sockets = found[path]
        values = exported.parameters
        assert name == exported.name
        assert meshes == ["ball", "plane"]
        assert sockets["Base Color"] == pytest.approx([*values["baseColorFactor"], 1.0], abs=1e-6)
        assert sockets["Metallic"] == pytest.approx(values["metallicFactor"], abs=1e-6)
        assert sockets["Roughness"] == pytest.approx(values["roughnessFactor"], abs=1e-6)
        assert sockets["IOR"] == pytest.approx(values["ior"], abs=1e-6)
        assert sockets["Specular IOR Level"] == pytest.approx(0.5 * values["specularFactor"], abs=1e-6)
        assert sockets["Specular Tint"] == pytest.approx([*values["specularColorFactor"], 1.0], abs=1e-6)
        assert sockets["Coat Weight"] == pytest.approx(values["clearcoatFactor"], abs=1e-6)
        if values["clearcoatFactor"]:
            assert sockets["Coat Roughness"] == pytest.approx(values["clearcoatRoughnessFactor"], abs=1e-6)
        sheen = [sockets["Sheen Weight"] * c for c in sockets["Sheen Tint"][:3]]
        assert sheen == pytest.approx(values["sheenColorFactor"], abs=1e-6)


# CIEDE2000 on the ball. Of sheen, Cycles has a table of the linearly transformed cosine, the model polynomials.
CYCLES = {
    "full": 0.05, "plain": 0.02, "metal": 0.02, 'cloth <&> "1"': 0.15, "diffuse": 0.01, "film": 0.05, "velvet": 0.5,
    "soap": 0.05, "oil": 0.08, "bubble": 0.1,
}  # fmt: skip
OTHERS = {
    "velvet": {"Base Color": [0.2, 0.1, 0.05], "Sheen Weight": 1.0, "Sheen Roughness": 0.5},
    "soap": {"Base Color": [0.05, 0.05, 0.1], "IOR": 1.6, "Roughness": 0.3, "Specular Tint": [1.0, 0.9, 0.7],
             "Thin Film Thickness": 550.0, "Thin Film IOR": 1.9},
    "oil": {"Base Color": [0.9, 0.6, 0.3], "Metallic": 1.0, "Roughness": 0.4, "Specular Tint": [0.8, 0.9, 1.0],
            "Thin Film Thickness": 240.0, "Thin Film IOR": 2.2},
    "bubble": {"Base Color": [0.3, 0.3, 0.3], "Specular IOR Level": 0.0, "Roughness": 0.3,
               "Thin Film Thickness": 300.0, "Thin Film IOR": 1.6},
}  # fmt: skip


def drawn_and_expected(picture, parameters, view, light):
    """Linear colours of pixels of a ball, (K, 3) each: drawn, and of the model."""
    right = normalize(np.cross([0.0, 0.0, 1.0], view))
    across = (2.0 * (np.arange(SIZE) + 0.5) / SIZE - 1.0) * EDGE
    x, y = np.meshgrid(across, across)
    inside = x * x + y * y < 0.9**2
    x, y = x[inside][:, None], y[inside][:, None]
    normal = x * right + y * np.cross(view, right) + np.sqrt(1.0 - x * x - y * y) * view
    tangent = normalize(
        np.cross([0.0, 0.0, 1.0], normal)
    )  # Blender's, where there are no texture coordinates
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    wi, wo = frame @ view, frame @ light
    lit = wo[:, 2] > 0.02
    drawn = picture[inside][lit]
    assert np.all(drawn[:, 3] == 1.0)
    return drawn[:, :3], np.pi * blender.brdf(parameters, ShadingPairs.of(wi[lit], wo[lit])) * wo[lit][:, 2:]


def test_cycles_draws_the_model_that_losses_are_measured_with(tmp_path):
    made = {str(path): exported for path, exported in (written(tmp_path, n, "blender") for n in known())}
    for name, values in OTHERS.items():
        if "Thin Film IOR" in values and "film" not in known():
            continue
        other = replace(export(name, "blender", MATERIALS["plain"]), parameters=blender.DEFAULTS | values)
        (tmp_path / f"{name}.py").write_text(blender.script(other))
        made[str(tmp_path / f"{name}.py")] = other
    view, light = normalize(np.array([0.0, -1.0, 0.3])), normalize(np.array([-0.5, -0.6, 0.7]))
    task = {
        "materials": {str(k): path for k, path in enumerate(made)}, "lights": {"sun": light.tolist()},
        "samples": [1, 1], "size": SIZE, "edge": EDGE, "filter": 0.01,  # a pixel is its centre
        "view": view.tolist(), "folder": str(tmp_path),
    }  # fmt: skip
    blender_module.run(blender_module.BALLS, task)
    for k, exported in enumerate(made.values()):
        picture = np.load(tmp_path / f"{k} sun.npy")
        linear = drawn_and_expected(picture, exported.parameters, view, light)
        difference = ball_colours.delta_e(*(srgb_to_xyz(np.clip(values, 0.0, 1.0)) for values in linear))
        print(exported.name, difference)
        assert difference < CYCLES[exported.name], exported.name
