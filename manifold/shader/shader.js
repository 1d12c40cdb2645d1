// The balls of a shader's page: the source and the shader side by side, sampled as a renderer does, and their difference.

import { COLOUR } from "./colour.js";
import { DIFFERENCE } from "./difference.js";
import { bindTexture, drawInto, makeProgram, makeTarget } from "./webgl.js";

const PER_FRAME = 4, MOST = 128; // samples per pixel, in a frame and in all
const EDGE = 1.08; // radii of the ball that half of a picture's side shows
const MEASURED = 128; // pixels across the pictures whose difference is printed
const DEGREES_PER_PIXEL = 0.4, DEGREES_PER_KEY = 5;
const data = JSON.parse(document.getElementById("data").textContent);
const at = (id) => document.getElementById(id);
const halves = (text) => new Uint16Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);

/** One sample of the light that a ball reflects, added to the samples of a pixel before. */
const PATH = (code) => `${code}
uniform highp sampler2D environment, before;
uniform vec3 view, sun; // towards them, in the world, z up
uniform float size, turn;
uniform int first, count;
uniform bool isSun;
out vec4 result;

vec3 radianceAt(vec3 w) {
  vec2 place = vec2(atan(w.x, w.y) / 6.28318530717959 + turn, acos(clamp(w.z, -1.0, 1.0)) / 3.14159265358979);
  return textureLod(environment, place, 0.0).rgb;
}

uint mixed(uint x) {
  x ^= x >> 16; x *= 0x7feb352du; x ^= x >> 15; x *= 0x846ca68bu;
  return x ^ (x >> 16);
}

void main() {
  vec2 place = (gl_FragCoord.xy / size * 2.0 - 1.0) * ${EDGE.toFixed(3)};
  result = vec4(0.0);
  float radius = dot(place, place);
  if (radius >= 1.0) return;
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  vec3 normal = place.x * right + place.y * up + sqrt(1.0 - radius) * view;
  vec3 tangent = normalize(abs(normal.z) < 0.9 ? cross(vec3(0.0, 0.0, 1.0), normal) : cross(vec3(1.0, 0.0, 0.0), normal));
  mat3 frame = mat3(tangent, cross(normal, tangent), normal);
  vec3 wi = view * frame;
  if (isSun) { // a white diffuser that faces the sun has radiance 1
    result = vec4(3.14159265358979 * manifold_eval(wi, sun * frame), 1.0);
    return;
  }
  result = first > 0 ? texelFetch(before, ivec2(gl_FragCoord.xy), 0) : vec4(0.0);
  uint seed = mixed(uint(gl_FragCoord.x) + 4096u * uint(gl_FragCoord.y));
  vec2 shift = vec2(seed & 0xffffu, seed >> 16) / 65536.0;
  for (int k = first; k < first + count; k++) {
    vec2 u = fract(shift + float(k) * vec2(0.754877666, 0.569840291)); // Roberts' R2 sequence
    vec4 drawn = manifold_sample(u, wi);
    result.a += 1.0;
    if (drawn.w > 0.0) result.rgb += manifold_eval(wi, drawn.xyz) / drawn.w * radianceAt(frame * drawn.xyz);
  }
}`;

const SHOW = `${COLOUR}
uniform highp sampler2D sums;
uniform float exposure;
out vec4 result;
void main() {
  vec4 sum = texelFetch(sums, ivec2(gl_FragCoord.xy), 0);
  result = sum.a > 0.0 ? vec4(encodeSrgb(exposure * sum.rgb / sum.a), 1.0) : vec4(0.0);
}`;

const COPY = `
uniform sampler2D picture;
uniform vec2 corner;
out vec4 result;
void main() { result = texelFetch(picture, ivec2(gl_FragCoord.xy - corner), 0); }`;

/** A texture of half floats as they are, of three or four channels. */
function halfTexture(gl, { width, height, halves: text, channels }, wrap) {
  const texture = gl.createTexture();
  const [kept, format] = channels === 4 ? [gl.RGBA16F, gl.RGBA] : [gl.RGB16F, gl.RGB];
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
  gl.texImage2D(gl.TEXTURE_2D, 0, kept, width, height, 0, format, gl.HALF_FLOAT, halves(text));
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wrap);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return texture;
}

/** A target of single floats, without a filter. */
function sumTarget(gl, size) {
  const picture = gl.createTexture(), target = gl.createFramebuffer();
  gl.bindTexture(gl.TEXTURE_2D, picture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, size, size);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
  return { picture, target, width: size, height: size };
}

/** Balls of the source and of the shader under one light, which become less noisy with every step. */
class Balls {
  constructor(gl, size) {
    Object.assign(this, { gl, size, count: 0 });
    this.sides = [data.reference, data.shader].map(({ code, table }) => ({
      program: makeProgram(gl, PATH(code)),
      table: halfTexture(gl, table, gl.CLAMP_TO_EDGE),
    }));
    this.environments = data.environments.map((one) => halfTexture(gl, one, gl.REPEAT));
    this.show = makeProgram(gl, SHOW);
    this.copy = makeProgram(gl, COPY);
    this.compare = makeProgram(gl, DIFFERENCE);
    this.resize(size);
  }

  resize(size) {
    const { gl } = this;
    for (const side of this.sides) {
      for (const { picture, target } of [...(side.sums ?? []), ...(side.shown ? [side.shown] : [])]) {
        gl.deleteTexture(picture);
        gl.deleteFramebuffer(target);
      }
      side.sums = [sumTarget(gl, size), sumTarget(gl, size)];
      side.shown = makeTarget(gl, size, size);
    }
    Object.assign(this, { size, count: 0 });
  }

  /** Add samples to both balls; a sun needs none. */
  step({ light, view, sun, turn }, samples) {
    const { gl, size, count } = this;
    for (const side of this.sides) {
      const { program, sums: [to, before] } = side;
      gl.useProgram(program.handle);
      bindTexture(gl, program, "manifold_table", 0, side.table);
      bindTexture(gl, program, "environment", 1, this.environments[Math.max(light, 0)]);
      bindTexture(gl, program, "before", 2, before.picture);
      gl.uniform3f(program.at("view"), ...view);
      gl.uniform3f(program.at("sun"), ...sun);
      gl.uniform1f(program.at("size"), size);
      gl.uniform1f(program.at("turn"), turn);
      gl.uniform1i(program.at("first"), count);
      gl.uniform1i(program.at("count"), samples);
      gl.uniform1i(program.at("isSun"), light < 0 ? 1 : 0);
      drawInto(gl, to);
      side.sums.reverse();
    }
    this.count = light < 0 ? MOST : count + samples;
  }

  /** Make display pictures of both. */
  develop(exposure) {
    const { gl, show } = this;
    for (const side of this.sides) {
      gl.useProgram(show.handle);
      bindTexture(gl, show, "sums", 0, side.sums[1].picture);
      gl.uniform1f(show.at("exposure"), exposure);
      drawInto(gl, side.shown);
    }
  }

  /** Draw both and their difference onto the canvas. */
  draw() {
    const { gl, size, copy } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.clearColor(0.12, 0.12, 0.12, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    this.sides.forEach(({ shown }, column) => {
      gl.viewport(column * size, 0, size, size);
      gl.useProgram(copy.handle);
      bindTexture(gl, copy, "picture", 0, shown.picture);
      gl.uniform2f(copy.at("corner"), column * size, 0);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    });
    gl.viewport(2 * size, 0, size, size);
    this._compare(2 * size, false);
    gl.disable(gl.BLEND);
  }

  /** CIEDE2000 of all pixels of the ball. */
  difference() {
    const { gl, size } = this, values = new Float32Array(4 * size * size), { target, picture } = sumTarget(gl, size);
    gl.viewport(0, 0, size, size);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    this._compare(0, true);
    gl.readPixels(0, 0, size, size, gl.RGBA, gl.FLOAT, values);
    gl.deleteFramebuffer(target);
    gl.deleteTexture(picture);
    const found = values.filter((_, k) => k % 4 === 0 && values[k + 3] > 0);
    return { mean: found.reduce((sum, v) => sum + v, 0) / found.length, worst: found.reduce((most, v) => Math.max(most, v), 0) };
  }

  _compare(left, isRaw) {
    const { gl, compare, sides: [source, shader] } = this;
    gl.useProgram(compare.handle);
    bindTexture(gl, compare, "one", 0, source.shown.picture);
    bindTexture(gl, compare, "other", 1, shader.shown.picture);
    gl.uniform2f(compare.at("corner"), left, 0);
    gl.uniform1i(compare.at("isRaw"), isRaw ? 1 : 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

function direction(azimuth, elevation) { // degrees
  const [a, e] = [azimuth, elevation].map((v) => (v * Math.PI) / 180);
  return [Math.sin(a) * Math.cos(e), Math.cos(a) * Math.cos(e), Math.sin(e)];
}

const state = { light: -1, sun: [135, 40], turn: 0, camera: 15, exposure: 0 };

/** Uniforms of the state: the viewer stands at azimuth 180, and light -1 is the sun. */
const lit = () => ({ light: state.light, view: direction(180, state.camera), sun: direction(...state.sun), turn: state.turn / 360 });

function start() {
  const canvas = at("balls"), gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
  if (!gl?.getExtension("EXT_color_buffer_float")) throw new Error("this page needs WebGL 2 with targets of floats");
  const balls = new Balls(gl, 1), small = new Balls(gl, MEASURED);
  let requested = 0;
  const frame = () => {
    requested = 0;
    const size = Math.max(16, Math.round((canvas.clientWidth / 3) * Math.min(devicePixelRatio, 2)));
    if (size !== balls.size) {
      [canvas.width, canvas.height] = [3 * size, size];
      balls.resize(size);
    }
    for (const each of [balls, small]) if (each.count < MOST) each.step(lit(), PER_FRAME);
    for (const each of [balls, small]) each.develop(2 ** state.exposure);
    balls.draw();
    const { mean, worst } = small.difference();
    at("difference").value = `${mean.toFixed(2)} in the mean, ${worst.toFixed(2)} at most`;
    at("samples").textContent = state.light < 0 ? "" : `${balls.count} samples per pixel`;
    document.body.dataset.ready = balls.count < MOST ? "drawing" : "done";
    if (balls.count < MOST) request();
  };
  const request = () => { requested ||= requestAnimationFrame(frame); };
  const change = (changes = {}) => {
    Object.assign(state, changes);
    if (!("exposure" in changes)) balls.count = small.count = 0;
    request();
  };
  const move = (x, y) => { // degrees to the right and up
    if (state.light < 0) {
      const [azimuth, elevation] = state.sun;
      change({ sun: [azimuth - x, Math.min(Math.max(elevation + y, -89), 89)] });
    } else change({ turn: state.turn + x });
  };
  ["Sun", ...data.environments.map(({ name }) => name)].forEach((name, k) => at("light").add(new Option(name, k - 1)));
  at("light").addEventListener("change", ({ target }) => change({ light: Number(target.value) }));
  at("exposure").addEventListener("input", ({ target }) => change({ exposure: Number(target.value) }));
  at("camera").addEventListener("input", ({ target }) => change({ camera: Number(target.value) }));
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) move(DEGREES_PER_PIXEL * event.movementX, -DEGREES_PER_PIXEL * event.movementY);
  });
  canvas.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!by) return;
    event.preventDefault();
    move(...by.map((v) => DEGREES_PER_KEY * v));
  });
  addEventListener("resize", () => change());
  window.shader = { state, balls, small, change, lit };
  change();
}

document.title = data.name;
at("name").textContent = data.name;
at("facts").textContent = data.facts;
at("of-source").textContent = data.source;
for (const note of data.notes) at("notes").appendChild(document.createElement("li")).textContent = note;
try {
  start();
} catch (error) {
  Object.assign(at("problem"), { hidden: false, textContent: error.message });
}
