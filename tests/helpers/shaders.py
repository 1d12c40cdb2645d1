"""The code of exported shaders, run in headless Chromium by WebGL 2."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from helpers.browser import PACKED, unpacked

from manifold.core.records import Array
from manifold.shader.table import Halves

_WIDTH = 256
_RUN = """([code, body, table, inputs, width, height]) => {
  const canvas = document.createElement("canvas"), gl = canvas.getContext("webgl2");
  gl.getExtension("EXT_color_buffer_float");
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const texture = (unit, kept, w, h, type, values, filter) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, kept, w, h, 0, gl.RGBA, type, values);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  };
  const program = gl.createProgram();
  const sources = [
    [gl.VERTEX_SHADER, `#version 300 es
      void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`],
    [gl.FRAGMENT_SHADER, `#version 300 es\n${code}
      uniform highp sampler2D first, second;
      out vec4 result;
      void main() {
        ivec2 at = ivec2(gl_FragCoord.xy);
        vec4 a = texelFetch(first, at, 0), b = texelFetch(second, at, 0);
        ${body}
      }`],
  ];
  for (const [kind, source] of sources) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  texture(0, gl.RGBA16F, table.width, table.height, gl.HALF_FLOAT, new Uint16Array(bytes(table.halves)), gl.LINEAR);
  inputs.forEach((text, k) => {
    texture(1 + k, gl.RGBA32F, width, height, gl.FLOAT, new Float32Array(bytes(text)), gl.NEAREST);
  });
  ["manifold_table", "first", "second"].forEach((name, k) => gl.uniform1i(gl.getUniformLocation(program, name), k));
  const target = gl.createTexture();
  gl.activeTexture(gl.TEXTURE3);
  gl.bindTexture(gl.TEXTURE_2D, target);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, width, height);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const values = new Float32Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, values);
  if (gl.getError()) throw new Error("WebGL failed");
  gl.getExtension("WEBGL_lose_context").loseContext();
  return packed(values);
}"""


class BrowserShader:
    """A shader whose functions run in a browser, with the interface of a BRDF."""

    def __init__(self, browser: Any, code: str, texels: Halves) -> None:
        self._code = code
        height, width, _ = texels.shape
        text = base64.b64encode(texels.astype("<f2").tobytes()).decode()
        self._table = {"width": width, "height": height, "halves": text}
        self._page = browser.new_page()
        self._page.goto("about:blank")
        self._page.evaluate(f"() => {{ {PACKED} }}")

    def run(self, body: str, first: Array, second: Array) -> Array:
        """What GLSL assigns to `result`, shape (K, 4), for inputs `a` and `b` of three or two numbers."""
        first, second = np.broadcast_arrays(*(_of_four(np.atleast_2d(values)) for values in (first, second)))
        count = len(first)
        height = -(-count // _WIDTH)
        inputs = []
        for values in (first, second):
            padded = np.zeros((height * _WIDTH, 4), "<f4")
            padded[:count] = values
            inputs.append(base64.b64encode(padded.tobytes()).decode())
        found = self._page.evaluate(_RUN, [self._code, body, self._table, inputs, _WIDTH, height])
        return unpacked(found, np.float32).reshape(-1, 4)[:count].astype(float)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        return self._shaped("result = vec4(manifold_eval(a.xyz, b.xyz), 0.0);", wi, wo)[..., :3]

    def pdf(self, wi: Array, wo: Array) -> Array:
        return self._shaped("result = vec4(manifold_pdf(a.xyz, b.xyz));", wi, wo)[..., 0]

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        found = self._shaped("result = manifold_sample(b.xy, a.xyz);", wi, u)
        return found[..., :3], found[..., 3]

    def _shaped(self, body: str, first: Array, second: Array) -> Array:
        shape = np.broadcast_shapes(first.shape[:-1], second.shape[:-1])
        flat = [np.broadcast_to(v, (*shape, v.shape[-1])).reshape(-1, v.shape[-1]) for v in (first, second)]
        return self.run(body, *flat).reshape(*shape, 4)


def _of_four(values: Array) -> Array:
    return np.pad(np.asarray(values, float), ((0, 0), (0, 4 - values.shape[1])))
