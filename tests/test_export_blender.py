"""Exports in Blender itself: its script, what its importers read, and what Cycles renders."""

from __future__ import annotations

import blender_module
import pytest
from test_export_files import MATERIALS, export, written

from manifold.fitting.exports import TARGETS

NAMES = ["it's a \"\"\"'''{NAME}\\n %s", "x" * 90, "a\x00b\udc80\n", "é" * 40]
"""That Blender, or a script, could stumble over; a name has at most 63 bytes in Blender 4."""


def scripts(folder):
    """Scripts by path: name and parameters."""
    made = {}
    for name in MATERIALS:
        path, exported = written(folder, name, "blender")
        made[str(path)] = name, exported.parameters
    for i, name in enumerate(NAMES):
        exported = export(name, "blender", MATERIALS["full"])
        path = folder / f"name_{i}.py"
        path.write_bytes(TARGETS["blender"].content(exported, MATERIALS["full"]))
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


def test_the_defaults_are_blender_s(tmp_path):
    path = tmp_path / "x.py"
    path.write_text(
        "import bpy\nmaterial = bpy.data.materials.get('x') or bpy.data.materials.new('x')\n"
        "if not material.node_tree: material.use_nodes = True"
    )
    ((sockets, *_),) = blender_module.run(blender_module.SCRIPTS, [str(path)])[str(path)].values()
    for key, value in TARGETS["blender"].defaults.items():
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
