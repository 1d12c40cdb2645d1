"""Writes binary glTF files (`.glb`) of a sphere and a plane with one material.

Source: glTF 2.0 specification, chapter 4 (GLB).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__
from manifold.core.records import Array
from manifold.fit.exports import gltf
from manifold.fit.exports.document import Export
from manifold.fit.exports.targets import FLAKES, Target

_COLUMNS, _ROWS = 64, 32


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh with V vertices and F faces.

    Attributes:
        name: name of the mesh.
        positions, normals: float32, shape (V, 3).
        tangents: directions along which anisotropic materials are rougher, with the sign of the bitangent, float32
            (V, 4).
        places: texture coordinates of the vertices, from the upper left corner, float32 (V, 2).
        triangles: vertex indices, counterclockwise seen from outside, uint16 (F, 3).
    """

    name: str
    positions: Array
    normals: Array
    tangents: Array
    places: Array
    triangles: Array


def ball() -> Mesh:
    """Return a unit sphere around the origin by longitude and latitude."""
    theta = np.linspace(0.0, np.pi, _ROWS + 1)[:, None]
    phi = np.linspace(0.0, 2.0 * np.pi, _COLUMNS + 1)[None]
    normals = np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta) + 0.0 * phi, np.sin(theta) * np.cos(phi)], axis=-1
    ).reshape(-1, 3)
    zero, one = np.zeros_like(theta * phi), np.ones_like(theta * phi)
    tangents = np.stack([np.cos(phi) * one, zero, -np.sin(phi) * one, one], axis=-1).reshape(-1, 4)
    row, column = (a.ravel() for a in np.meshgrid(np.arange(_ROWS), np.arange(_COLUMNS), indexing="ij"))
    a = row * (_COLUMNS + 1) + column
    b, c, d = a + _COLUMNS + 1, a + _COLUMNS + 2, a + 1
    upper = np.stack([a, b, d], axis=1)[row > 0]  # at the poles one triangle has no area
    lower = np.stack([d, b, c], axis=1)[row < _ROWS - 1]
    places = np.stack([phi / np.pi * one, theta / np.pi + 0.0 * phi], axis=-1).reshape(-1, 2)  # twice around
    return _mesh("ball", normals, normals, tangents, places, np.concatenate([upper, lower]))


def plane() -> Mesh:
    """Return a square of side 2 that faces up."""
    positions = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 0.0, -1.0]])
    normals = np.tile([0.0, 1.0, 0.0], (4, 1))
    tangents = np.tile([1.0, 0.0, 0.0, 1.0], (4, 1))
    places = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    return _mesh("plane", positions, normals, tangents, places, np.array([[0, 1, 2], [0, 2, 3]]))


def _mesh(
    name: str, positions: Array, normals: Array, tangents: Array, places: Array, triangles: Array
) -> Mesh:
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(
        name,
        positions.astype("<f4"),
        normals.astype("<f4"),
        tangents.astype("<f4"),
        places.astype("<f4"),
        triangles.astype("<u2"),
    )


_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_FLOAT, _UINT16, _VERTICES, _INDICES, _REPEAT = 5126, 5123, 34962, 34963, 10497


def glb(export: Export) -> bytes:
    """Return the bytes of the file: nodes `ball` and `plane`, one material, with errors and source in its extras."""
    material: dict[str, Any] = gltf.to_json(export.parameters, export.label) | {"extras": export.about()}
    is_anisotropic = "KHR_materials_anisotropy" in material.get("extensions", {})
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"Exported by manifold {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [
            {"name": "ball", "mesh": 0, "translation": [0.0, 1.0, 0.0]},
            {"name": "plane", "mesh": 1, "translation": [0.0, 0.0, -2.5]},
        ],
        "materials": [material],
        "meshes": [], "accessors": [], "bufferViews": [], "buffers": [],
    }  # fmt: skip
    content = bytearray()
    textures = export.textures
    if textures is not None:
        _add_textures(document, content, list(textures.named.values()))
        material["pbrMetallicRoughness"] |= {
            "baseColorFactor": [1.0, 1.0, 1.0, 1.0],
            "baseColorTexture": {"index": 0},
        }
        material["normalTexture"] = {"index": 1}
        if textures.coat is not None:
            material.setdefault("extensions", {})["KHR_materials_clearcoat"] = {
                "clearcoatFactor": 1.0,
                "clearcoatTexture": {"index": 2},
                "clearcoatRoughnessFactor": 1.0,
                "clearcoatRoughnessTexture": {"index": 2},
                "clearcoatNormalTexture": {"index": 3},
            }
    if used := sorted(material.get("extensions", {})):
        document["extensionsUsed"] = used
    for mesh in (ball(), plane()):
        document["meshes"].append(
            _add_mesh(
                document, content, mesh, with_tangents=is_anisotropic or textures is not None,
                with_places=textures is not None,
            )
        )  # fmt: skip
    document["buffers"] = [{"byteLength": len(content)}]
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    chunks = _chunk(_JSON, text, b" ") + _chunk(_BIN, bytes(content), b"\0")
    return struct.pack("<III", _MAGIC, _VERSION, 12 + len(chunks)) + chunks


def _chunk(kind: int, content: bytes, padding: bytes) -> bytes:
    content += padding * (-len(content) % 4)
    return struct.pack("<II", len(content), kind) + content


def _add_textures(document: dict[str, Any], content: bytearray, pictures: Sequence[Path]) -> None:
    """Append PNGs to the buffer, as textures that repeat."""
    document |= {"images": [], "textures": [], "samplers": [{"wrapS": _REPEAT, "wrapT": _REPEAT}]}
    for picture in pictures:
        content += b"\0" * (-len(content) % 4)
        data = picture.read_bytes()
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(content), "byteLength": len(data)})
        content += data
        view = len(document["bufferViews"]) - 1
        document["images"].append({"bufferView": view, "mimeType": "image/png", "name": picture.stem})
        document["textures"].append({"source": len(document["images"]) - 1, "sampler": 0})


def _add_mesh(
    document: dict[str, Any], content: bytearray, mesh: Mesh, *, with_tangents: bool, with_places: bool
) -> dict[str, Any]:
    attributes = {
        "POSITION": _add(document, content, mesh.positions, _VERTICES, with_bounds=True),
        "NORMAL": _add(document, content, mesh.normals, _VERTICES),
    }
    if with_tangents:
        attributes["TANGENT"] = _add(document, content, mesh.tangents, _VERTICES)
    if with_places:
        attributes["TEXCOORD_0"] = _add(document, content, mesh.places, _VERTICES)
    indices = _add(document, content, mesh.triangles.reshape(-1, 1), _INDICES)
    return {
        "name": mesh.name,
        "primitives": [{"attributes": attributes, "indices": indices, "material": 0}],
    }


def _add(
    document: dict[str, Any], content: bytearray, values: Array, target: int, *, with_bounds: bool = False
) -> int:
    """Append an array to the buffer; the index of its accessor."""
    content += b"\0" * (-len(content) % 4)
    document["bufferViews"].append(
        {"buffer": 0, "byteOffset": len(content), "byteLength": values.nbytes, "target": target}
    )
    content += values.tobytes()
    accessor: dict[str, Any] = {
        "bufferView": len(document["bufferViews"]) - 1,
        "componentType": _FLOAT if values.dtype.kind == "f" else _UINT16,
        "count": len(values),
        "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[values.shape[1]],
    }
    if with_bounds:
        accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
    document["accessors"].append(accessor)
    return len(document["accessors"]) - 1


GLTF = Target(
    name="gltf",
    suffix=".glb",
    title="glTF 2.0, metallic-roughness and extensions",
    entries=gltf.PARAMETERS,
    parameters=gltf.parameters,
    brdf=gltf.brdf,
    content=glb,
    base_colour=gltf.BASE_COLOUR,
    coat=gltf.COAT,
    sheen=gltf.SHEEN,
    film=gltf.FILM,
    textures=FLAKES,
)
