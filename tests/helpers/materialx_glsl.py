"""Materials of MaterialX as its own shaders, generated for WebGL, draw them in headless Chromium."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

_WIDTH = 64
_PAGE = """<!doctype html><canvas id="canvas"></canvas><script>
const gl = document.getElementById("canvas").getContext("webgl2");
gl.getExtension("EXT_color_buffer_float");
const compiled = (kind, source) => {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
};
const programs = {}; // by source: many seconds each
const linked = (vertex, pixel) => {
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, compiled(gl.FRAGMENT_SHADER, pixel));
  gl.linkProgram(program);
  return program;
};
window.draw = ({ vertex, pixel, uniforms, attributes, count, width }) => {
  const program = programs[pixel] ??= linked(vertex, pixel), rows = Math.ceil(count / width);
  gl.useProgram(program);
  for (const [name, kind, value] of uniforms) {
    const at = gl.getUniformLocation(program, name);
    if (kind === "matrix") gl.uniformMatrix4fv(at, false, value);
    else if (kind === "integer") gl.uniform1i(at, value);
    else if (kind === "float") gl.uniform1f(at, value);
    else gl.uniform3fv(at, value);
  }
  for (const [name, values] of Object.entries(attributes)) {
    const at = gl.getAttribLocation(program, name);
    if (at < 0) continue; // not used by this material
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
  }
  const target = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, target);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, rows);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, width, rows);
  gl.drawArrays(gl.POINTS, 0, count);
  const values = new Float32Array(4 * width * rows);
  gl.readPixels(0, 0, width, rows, gl.RGBA, gl.FLOAT, values);
  return [...values.subarray(0, 4 * count)];
};
</script>"""


def mtlx_document(content: bytes) -> Any:
    """A document with MaterialX's libraries."""
    mx = pytest.importorskip(
        "MaterialX", reason="the MaterialX library is not installed (pip install materialx)"
    )
    document, library = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    mx.readFromXmlString(document, content.decode())
    document.setDataLibrary(library)
    return document


class MaterialXGlsl:
    """A page that draws points, one a pixel, with a generated shader."""

    def __init__(self, browser: Any) -> None:
        self._page = browser.new_page()
        self._page.set_content(_PAGE)

    def radiance(self, document: Any, view: np.ndarray, light: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Linear radiance (P, 3) under one light that gives a white diffuser which faces it radiance 1.

        Args:
            document: with one material.
            view, light: unit vectors (3,).
            frames: tangent, bitangent and normal of each point as rows, shape (P, 3, 3).
        """
        vertex, pixel, uniforms = _shader(document)
        rows = -(-len(frames) // _WIDTH)
        x, y = np.arange(len(frames)) % _WIDTH, np.arange(len(frames)) // _WIDTH
        at = np.column_stack([(2 * x + 1) / _WIDTH - 1, (2 * y + 1) / rows - 1, np.zeros(len(frames))])
        matrices = ("u_worldMatrix", "u_viewProjectionMatrix", "u_worldInverseTransposeMatrix")
        uniforms += [(name, "matrix", np.eye(4).ravel().tolist()) for name in matrices]
        uniforms += [
            ("u_viewPosition", "vector", (1e6 * view).tolist()),
            ("u_numActiveLightSources", "integer", 1),
            ("u_lightData[0].type", "integer", 1),
            ("u_lightData[0].direction", "vector", (-light).tolist()),
            ("u_lightData[0].color", "vector", [1.0, 1.0, 1.0]),
            ("u_lightData[0].intensity", "float", np.pi),
        ]
        drawn = {"i_position": at, "i_normal": frames[:, 2], "i_tangent": frames[:, 0]}
        task = {
            "vertex": vertex.replace("void main()\n{", "void main()\n{\n    gl_PointSize = 1.0;"),
            "pixel": pixel,
            "uniforms": uniforms,
            "attributes": {name: values.ravel().tolist() for name, values in drawn.items()},
            "count": len(frames),
            "width": _WIDTH,
        }
        return np.array(self._page.evaluate("task => draw(task)", task)).reshape(-1, 4)[:, :3]


def _shader(document: Any) -> tuple[str, str, list[tuple[str, str, Any]]]:
    """Sources of both stages, and the uniforms that hold the material's inputs."""
    import MaterialX as mx
    from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenShader

    generator = PyMaterialXGenGlsl.EsslShaderGenerator.create()
    context = PyMaterialXGenShader.GenContext(generator)
    context.registerSourceCodeSearchPath(mx.getDefaultDataSearchPath())
    options, none = context.getOptions(), PyMaterialXGenShader.HwSpecularEnvironmentMethod
    options.hwSpecularEnvironmentMethod = none.SPECULAR_ENVIRONMENT_NONE
    options.hwMaxActiveLightSources = 1
    lamp = document.getNodeDef("ND_directional_light")
    PyMaterialXGenShader.HwShaderGenerator.bindLightShader(lamp, 1, context)
    (element,) = PyMaterialXGenShader.findRenderableElements(document)
    shader = generator.generate("material", element, context)
    uniforms = []
    for port in shader.getStage("pixel").getUniformBlock("PublicUniforms"):
        value, kind = port.getValue(), port.getType().getName()
        if value is not None and kind in ("float", "integer", "boolean", "color3", "vector3"):
            data = value.getData()
            made = [data[k] for k in range(3)] if kind in ("color3", "vector3") else data
            uniforms.append((port.getVariable(), "integer" if kind == "boolean" else kind, made))
    pixel, forgotten = shader.getSourceCode("pixel"), "bool u_refractionTwoSided"
    if forgotten not in pixel:  # by MaterialX 1.39.5 where there is no environment
        pixel = pixel.replace("precision highp float;", f"precision highp float;\nconst {forgotten} = false;")
    return shader.getSourceCode("vertex"), pixel, uniforms
