"""Writes USD layers (`.usda`) of a sphere and a plane with a UsdPreviewSurface, and optionally OpenPBR, material."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from manifold.fit.exports import glb, openpbr, preview_surface
from manifold.fit.exports.document import Export, TextureFiles
from manifold.fit.exports.glb import Mesh
from manifold.fit.exports.materialx import TURN, identifier
from manifold.fit.exports.targets import RELIEF, Target

COLOUR_SPACE = "lin_rec709_scene"
"""OpenUSD's name of linear Rec. 709 (`GfColorSpaceNames`), metadata of colours."""
OPENPBR_ID = "ND_open_pbr_surface_surfaceshader"


def usda(export: Export) -> str:
    """Return the text of the layer, with y up and lengths in metres.

    `outputs:surface` is for previews, and `outputs:mtlx:surface` for MaterialX renderers.

    Args:
        export: the material, with the parameters of UsdPreviewSurface and, in `beside`, of OpenPBR; a `beside` of
            None leaves OpenPBR out, for checkers without USD's plugin for MaterialX.
    """
    output = second = placed = nodes = ""
    name = identifier(export.name)
    path = f"/World/Materials/{name}"
    own = dict(export.parameters)
    is_textured = export.textures is not None
    if export.textures is not None:
        own["diffuseColor"] = preview_surface.DEFAULTS["diffuseColor"]
        placed, nodes = _textured(path, export.textures)
    if export.beside is not None:
        output = f"            token outputs:mtlx:surface.connect = <{path}/OpenPBR.outputs:out>\n"
        values = dict(export.beside)
        turned = _turned_tangent(path, values.pop("geometry_tangent"))
        tangent = f"                float3 inputs:geometry_tangent.connect = <{path}/rotate3d.outputs:out>\n"
        second = f"""
            def Shader "OpenPBR"
            {{
                uniform token info:id = "{OPENPBR_ID}"
{_inputs(values, openpbr.DEFAULTS)}{tangent if turned else ""}                token outputs:out
            }}
{turned}"""
    return f"""#usda 1.0
(
    defaultPrim = "World"
    doc = {json.dumps(export.sentence(), ensure_ascii=False)}
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "World"
{{
    def Scope "Materials"
    {{
        def Material "{name}"
        {{
            token outputs:surface.connect = <{path}/Preview.outputs:surface>
{output}
            def Shader "Preview"
            {{
                uniform token info:id = "UsdPreviewSurface"
{_inputs(own, preview_surface.DEFAULTS)}{placed}                token outputs:surface
            }}
{nodes}{second}        }}
    }}

{_mesh(glb.ball(), path, (0.0, 1.0, 0.0), is_textured=is_textured)}
{_mesh(glb.plane(), path, (0.0, 0.0, -2.5), is_textured=is_textured)}}}
"""


def _textured(path: str, textures: TextureFiles) -> tuple[str, str]:
    """Return the inputs of UsdPreviewSurface that come from textures, and the nodes that read these."""
    inputs = {"diffuseColor": "color3f", "normal": "normal3f"}
    placed = "".join(
        f"{' ' * 16}{kind} inputs:{key}.connect = <{path}/{key}.outputs:rgb>\n"
        for key, kind in inputs.items()
    )
    nodes = """
            def Shader "places"
            {
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }
"""
    for key, picture in (("diffuseColor", textures.base_colour), ("normal", textures.normal)):
        signed = key == "normal"
        scale = "(2, 2, 2, 1)" if signed else "(1, 1, 1, 1)"
        bias = "(-1, -1, -1, 0)" if signed else "(0, 0, 0, 0)"
        nodes += f"""
            def Shader "{key}"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @./{picture.name}@
                float4 inputs:bias = {bias}
                float4 inputs:scale = {scale}
                token inputs:sourceColorSpace = "{"raw" if signed else "sRGB"}"
                float2 inputs:st.connect = <{path}/places.outputs:result>
                token inputs:wrapS = "repeat"
                token inputs:wrapT = "repeat"
                float3 outputs:rgb
            }}
"""
    return placed, nodes


def _turned_tangent(path: str, degrees: float) -> str:
    """Return nodes of MaterialX that turn the tangent; empty for 0."""
    if not degrees:
        return ""
    world = '                string inputs:space = "world"\n'
    turn = f"                float inputs:amount = {-degrees:.9g}\n"  # clockwise
    for name, node in zip(("in", "axis"), TURN, strict=False):
        turn += f"                float3 inputs:{name}.connect = <{path}/{node}.outputs:out>\n"
    return "".join(
        f"""
            def Shader "{kind}"
            {{
                uniform token info:id = "ND_{kind}_vector3"
{inputs}                float3 outputs:out
            }}
"""
        for kind, inputs in zip(TURN, (world, world, turn), strict=True)
    )


def _inputs(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> str:
    lines = []
    for key, value in values.items():
        if value != defaults[key]:
            kind = {list: "color3f", int: "int"}.get(type(value), "float")
            text = _tuple(value) if isinstance(value, list) else f"{value:.9g}"
            space = f' (colorSpace = "{COLOUR_SPACE}")' if kind == "color3f" else ""
            lines.append(f"{' ' * 16}{kind} inputs:{key} = {text}{space}\n")
    return "".join(lines)


def _tuple(values: Any) -> str:
    return "(" + ", ".join(f"{float(v):.9g}" for v in values) + ")"


def _mesh(mesh: Mesh, material: str, place: tuple[float, float, float], *, is_textured: bool) -> str:
    points = ", ".join(_tuple(p) for p in mesh.positions)
    normals = ", ".join(_tuple(n) for n in mesh.normals)
    places = ""
    if is_textured:
        texture = ", ".join(_tuple((u, 1.0 - v)) for u, v in mesh.places)
        vertex = '(\n            interpolation = "vertex"\n        )\n'
        places = f"        texCoord2f[] primvars:st = [{texture}] {vertex}"
    extent = f"{_tuple(mesh.positions.min(axis=0))}, {_tuple(mesh.positions.max(axis=0))}"
    return f"""    def Mesh "{mesh.name}" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        float3[] extent = [{extent}]
        int[] faceVertexCounts = [{", ".join(["3"] * len(mesh.triangles))}]
        int[] faceVertexIndices = [{", ".join(map(str, mesh.triangles.ravel()))}]
        rel material:binding = <{material}>
        point3f[] points = [{points}]
        normal3f[] normals = [{normals}] (
            interpolation = "vertex"
        )
{places}        uniform token subdivisionScheme = "none"
        double3 xformOp:translate = {_tuple(place)}
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
"""


USD = Target(
    name="usd",
    suffix=".usda",
    title="USD, UsdPreviewSurface",
    entries=preview_surface.PARAMETERS,
    parameters=preview_surface.parameters,
    brdf=preview_surface.brdf,
    content=lambda export: usda(export).encode(),
    base_colour=preview_surface.BASE_COLOUR,
    coat=preview_surface.COAT,
    hued=preview_surface.HUED,
    textures=RELIEF,
)

USD_MATERIALX = replace(
    USD,
    name="usd-materialx",
    title="USD, UsdPreviewSurface with OpenPBR beside it for MaterialX renderers",
    textures=(),
    beside="openpbr",
)
