// Programs, textures and targets of WebGL2 that cover their whole target with one triangle.

const VERSION = "#version 300 es\n";
const QUAD = `${VERSION}
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
// Fragment shaders have integers of 16 bits and textures of 8 by default, and some drivers do use so few.
const PRECISE = `${VERSION}precision highp float; precision highp int; precision highp sampler2D; precision highp samplerCube;`;

/** A program of a fragment shader, without its version and precisions: its handle, and `at(name)`, the place of a uniform. */
export function makeProgram(gl, fragment) {
  const handle = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, QUAD], [gl.FRAGMENT_SHADER, PRECISE + fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(handle, shader);
  }
  gl.linkProgram(handle);
  if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = gl.getAttachedShaders(handle).map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(`a shader does not compile: ${logs.join(" ")} ${gl.getProgramInfoLog(handle)}`);
  }
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(handle, name));
    return places.get(name);
  };
  return { handle, at };
}

/** A texture of half floats, linear between its texels, around in the first direction; filled later where values are null. */
export function makeTexture(gl, width, height, values, { filter = gl.LINEAR, wrap = gl.REPEAT } = {}) {
  const texture = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.FLOAT, values);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wrap);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return texture;
}

/** A texture of a picture that repeats, with mipmaps; the format says whether its values are linear. */
export function makePattern(gl, picture, format) {
  const texture = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, format, gl.RGBA, gl.UNSIGNED_BYTE, picture);
  gl.generateMipmap(gl.TEXTURE_2D);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
  return texture;
}

/** A texture that can be drawn into; options as of `makeTexture`. */
export function makeTarget(gl, width, height, options) {
  const target = gl.createFramebuffer(), picture = makeTexture(gl, width, height, null, options);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
  return { picture, target, width, height };
}

/** A cube of half floats with mipmaps, and targets that draw into its faces. */
export function makeCube(gl, size) {
  const picture = gl.createTexture(), levels = Math.log2(size) + 1;
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_CUBE_MAP, picture);
  gl.texStorage2D(gl.TEXTURE_CUBE_MAP, levels, gl.RGBA16F, size, size);
  gl.texParameteri(gl.TEXTURE_CUBE_MAP, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
  const targets = [...Array(6).keys()].map((face) => {
    const target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_CUBE_MAP_POSITIVE_X + face, picture, 0);
    return target;
  });
  return { picture, targets };
}

/** Let a program read a texture by a unit. */
export function bindTexture(gl, program, name, unit, texture) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.uniform1i(program.at(name), unit);
}

/** Draw with the program in use into all of a target, or its first columns and rows. */
export function drawInto(gl, { target, width, height }, columns = width, rows = height) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  gl.viewport(0, 0, columns, rows);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}
