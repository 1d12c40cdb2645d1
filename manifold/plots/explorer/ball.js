// A ball under the studio's light or under a lamp, in WebGL2, from one table of cube roots per prediction.

import { BlendRenderer } from "./blend.js";
import { bindTexture, drawInto, makeProgram, makeTarget, makeTexture } from "./webgl.js";

const AZIMUTHS = 96, ELEVATIONS = 48; // of the picture in polar coordinates, which the studio lights first
// Rings and spokes of half vectors: as in manifold/colour/ball_colours.py while moving, finer at rest.
const MOVING = [18, 12], RESTING = [36, 24]; // products of four
const ACROSS = 8; // fours of half vectors beside each other in the texture of their light
const SCALE = 256; // of what a half vector contributes, so that half floats hold it

const COMMON = `
uniform sampler2D table; // cube roots of f cos(theta_i) cos(theta_o): phi_d across, theta_d within theta_h down
uniform vec3 nodes, view;
uniform float thetaHMax, thetaHPower, thetaDShare;
const float PI = 3.14159265358979;
out vec4 result;

vec3 fCosines(float thetaH, float cosD, float phiD) {
  float largest = atan(1.0, tan(thetaH) * abs(cos(phiD)));
  float h = pow(clamp(thetaH / thetaHMax, 0.0, 1.0), 1.0 / thetaHPower);
  float d = clamp(acos(clamp(cosD, -1.0, 1.0)) / largest / thetaDShare, 0.0, 1.0);
  float layer = h * (nodes.z - 1.0), below = min(floor(layer), nodes.z - 2.0);
  vec2 at = vec2(abs(phiD) / PI, d) * (nodes.xy - 1.0) + 0.5 + vec2(0.0, below * nodes.y);
  vec2 size = vec2(nodes.x, nodes.y * nodes.z);
  vec3 root = mix(textureLod(table, at / size, 0.0).rgb,
    textureLod(table, (at + vec2(0.0, nodes.y)) / size, 0.0).rgb, layer - below);
  return root * root * root;
}

// Frame of the surface at a place of the disc, (right, up) in radii.
mat3 frameAt(vec2 place) {
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  vec3 normal = place.x * right + place.y * up + sqrt(max(1.0 - dot(place, place), 0.0)) * view;
  vec3 tangent = normalize(cross(up, normal));
  return mat3(tangent, cross(normal, tangent), normal);
}

float phiDifference(vec3 w, float thetaH, float phiH) {
  float x = cos(thetaH) * (w.x * cos(phiH) + w.y * sin(phiH)) - sin(thetaH) * w.z;
  return atan(w.y * cos(phiH) - w.x * sin(phiH), x);
}
`;

// The surface at an elevation: its local frame has the viewer over the first axis.
const HALF_VECTORS = `
uniform int rings, spokes;
struct Half { float theta, phi, cosine, area; vec3 wi, wo; };

Half halfVector(int index, float row) {
  float theta = min((row + 0.5) / ${ELEVATIONS}.0, 0.985) * 0.5 * PI;
  int ring = index / spokes;
  float u = (float(ring) + 0.5) / float(rings);
  Half h;
  h.theta = 0.5 * PI * u * u;
  h.phi = 2.0 * PI * ((float(index - ring * spokes) + 0.5) / float(spokes) + 0.6180339887498949 * float(ring));
  h.area = sin(h.theta) * PI * u / float(rings) * 2.0 * PI / float(spokes);
  h.wi = vec3(sin(theta), 0.0, cos(theta));
  vec3 m = vec3(sin(h.theta) * cos(h.phi), sin(h.theta) * sin(h.phi), cos(h.theta));
  h.cosine = dot(h.wi, m);
  h.wo = 2.0 * h.cosine * m - h.wi;
  return h;
}
`;

// The light that arrives along each half vector at each place, four to a texel: once, whatever the material.
const LIGHT = `${COMMON}${HALF_VECTORS}
uniform sampler2D environment;
uniform vec2 cells;

float lightAlong(int index, vec2 place) {
  Half h = halfVector(index, place.y);
  if (h.cosine <= 0.0 || h.wo.z <= 0.0) return 0.0;
  float azimuth = (place.x + 0.5) / ${AZIMUTHS}.0 * 2.0 * PI;
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  vec3 outwards = cos(azimuth) * right + sin(azimuth) * up;
  vec3 normal = h.wi.x * outwards + h.wi.z * view, tangent = h.wi.x * view - h.wi.z * outwards;
  vec3 world = h.wo.x * tangent + h.wo.y * cross(normal, tangent) + h.wo.z * normal;
  vec2 look = vec2(atan(world.x, world.y) / (2.0 * PI), acos(clamp(world.z, -1.0, 1.0)) / PI);
  // Averaged over half the width of what a half vector stands for, else lamps leave the pattern of half vectors.
  float texel = 2.0 * PI * PI / cells.x / cells.y * max(length(world.xy), 0.1);
  float wide = 0.5 * log2(max(4.0 * h.cosine * h.area / texel, 4.0)) - 1.0;
  return textureLod(environment, look, wide).r;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), place = ivec2(at.x % ${AZIMUTHS}, at.y % ${ELEVATIONS});
  int four = at.x / ${AZIMUTHS} + ${ACROSS} * (at.y / ${ELEVATIONS});
  vec4 here = vec4(0.0);
  for (int r = 0; r < 4 && four < rings * spokes / 4; r++) here[r] = lightAlong(4 * four + r, vec2(place));
  result = here;
}`;

// What each half vector contributes per light, at each elevation.
const MATERIAL = `${COMMON}${HALF_VECTORS}
void main() {
  Half h = halfVector(int(gl_FragCoord.x), floor(gl_FragCoord.y));
  result = vec4(0.0);
  if (h.cosine <= 0.0 || h.wo.z <= 0.0) return;
  vec3 f = fCosines(h.theta, h.cosine, phiDifference(h.wi, h.theta, h.phi)) / h.wi.z;
  result = vec4(clamp(f * (${SCALE}.0 * 4.0 * h.cosine * h.area), -6e4, 6e4), 0.0);
}`;

// The same, channel by channel, four half vectors to a texel.
const TURN = `
uniform sampler2D contribution;
out vec4 result;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 four;
  for (int r = 0; r < 4; r++) four[r] = texelFetch(contribution, ivec2(at.x / 3 * 4 + r, at.y), 0)[at.x % 3];
  result = four;
}`;

const SUM = `
uniform sampler2D channels, light;
uniform int fours;
out vec4 result;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 sum = vec3(0.0);
  for (int m = 0; m < fours; m++) {
    vec4 here = texelFetch(light, at + ivec2(m % ${ACROSS} * ${AZIMUTHS}, m / ${ACROSS} * ${ELEVATIONS}), 0);
    for (int c = 0; c < 3; c++) sum[c] += dot(texelFetch(channels, ivec2(3 * m + c, at.y), 0), here);
  }
  result = vec4(sum / ${SCALE}.0, 1.0);
}`;

const SHOW = `${COMMON}
uniform sampler2D lit;
uniform vec2 corner;
uniform float side, exposure, flip;
uniform bool isLamp;
uniform vec3 lamp; // towards the lamp: right, up, towards the viewer

vec3 encoded(vec3 linear) {
  vec3 c = clamp(linear, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}

void main() {
  vec2 place = ((gl_FragCoord.xy - corner) / side * 2.0 - 1.0) * 1.02;
  place.y *= flip;
  float radius = length(place), edge = 3.0 / side;
  float alpha = clamp((1.0 - radius) / edge + 0.5, 0.0, 1.0);
  if (alpha <= 0.0) { result = vec4(0.0); return; }
  place *= min(1.0, 0.999 / max(radius, 1e-6));
  vec3 linear;
  if (isLamp) {
    mat3 frame = frameAt(place);
    vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
    vec3 wi = view * frame, wo = (lamp.x * right + lamp.y * up + lamp.z * view) * frame;
    linear = vec3(0.0);
    if (wo.z > 0.0) {
      vec3 h = normalize(wi + wo);
      float thetaH = atan(length(h.xy), h.z), phiH = atan(h.y, h.x);
      linear = PI * fCosines(thetaH, dot(wi, h), phiDifference(wi, thetaH, phiH)) / wi.z;
    }
  } else {
    float theta = asin(min(length(place), 1.0)), azimuth = atan(place.y, place.x);
    linear = texture(lit, vec2(azimuth / (2.0 * PI), theta / (0.5 * PI))).rgb;
  }
  result = vec4(encoded(linear * exposure) * alpha, alpha);
}`;

/** Draws predictions as balls into the canvas it is given; `null` of `create` where there is no WebGL2. */
export class BallRenderer {
  static create(canvas, materials) {
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: false });
    if (!gl || !(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"))) {
      return null;
    }
    return BlendRenderer.fits(gl, materials) ? new BallRenderer(gl, materials) : null;
  }

  constructor(gl, materials) {
    const { data } = materials;
    this.gl = gl;
    this.data = data;
    this.blends = new BlendRenderer(gl, materials);
    const { light } = data;
    this.programs = Object.fromEntries(Object.entries({ light: LIGHT, material: MATERIAL, turn: TURN, sum: SUM })
      .map(([name, fragment]) => [name, makeProgram(gl, fragment)]));
    this.show = makeProgram(gl, SHOW);
    const radiance = new Float32Array(light.radiance.length * 4);
    light.radiance.forEach((v, k) => radiance.fill(v, 4 * k, 4 * k + 4));
    this.environment = makeTexture(gl, light.columns, light.rows, radiance);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.generateMipmap(gl.TEXTURE_2D);
    this.lights = new Map(); // by the number of rings
    this.surfaces = [];
    this.thumbnail = null;
  }

  /** Take a prediction under an illuminant as surface 0, 1, ..., and light it by the studio, both coarsely. */
  setSurface(k, prediction, illuminant) {
    const { gl, blends } = this;
    this.surfaces[k] ??= { table: blends.table(), ...makeTarget(gl, AZIMUTHS, ELEVATIONS) };
    Object.assign(this.surfaces[k], { prediction, illuminant });
    blends.draw(this.surfaces[k].table, prediction, illuminant, true);
    this._lightByStudio(this.surfaces[k], MOVING);
  }

  /** Blend and light a surface again, as finely as befits a still picture. */
  refine(k) {
    const surface = this.surfaces[k];
    if (!surface) return;
    this.blends.draw(surface.table, surface.prediction, surface.illuminant, false);
    this._lightByStudio(surface, RESTING);
  }

  _lightByStudio(surface, [rings, spokes]) {
    const { gl } = this, { material, turn, sum } = this.programs;
    const { light, contribution, channels } = this._light(rings, spokes);
    this._use(material, surface);
    gl.uniform1i(material.at("rings"), rings);
    gl.uniform1i(material.at("spokes"), spokes);
    drawInto(gl, contribution);
    gl.useProgram(turn.handle);
    bindTexture(gl, turn, "contribution", 0, contribution.picture);
    drawInto(gl, channels);
    gl.useProgram(sum.handle);
    bindTexture(gl, sum, "channels", 0, channels.picture);
    bindTexture(gl, sum, "light", 1, light.picture);
    gl.uniform1i(sum.at("fours"), (rings * spokes) / 4);
    drawInto(gl, surface);
  }

  /** The light along half vectors at all places, made when first asked for, and room for what a material makes of it. */
  _light(rings, spokes) {
    if (this.lights.has(rings)) return this.lights.get(rings);
    const { gl, data } = this, { light: program } = this.programs, count = rings * spokes;
    const made = {
      light: makeTarget(gl, AZIMUTHS * ACROSS, ELEVATIONS * Math.ceil(count / 4 / ACROSS)),
      contribution: makeTarget(gl, count, ELEVATIONS), channels: makeTarget(gl, (3 * count) / 4, ELEVATIONS),
    };
    gl.useProgram(program.handle);
    bindTexture(gl, program, "environment", 0, this.environment);
    gl.uniform1i(program.at("rings"), rings);
    gl.uniform1i(program.at("spokes"), spokes);
    gl.uniform3f(program.at("view"), ...data.light.view);
    gl.uniform2f(program.at("cells"), data.light.columns, data.light.rows);
    drawInto(gl, made.light);
    this.lights.set(rings, made);
    return made;
  }

  /** Draw surfaces side by side, each in a square; light is {lamp: null or direction, exposure}. */
  draw(surfaces, light) {
    const { gl } = this, { width, height } = gl.canvas;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const side = Math.min(height, width / surfaces.length);
    surfaces.forEach((k, column) => {
      const left = (width - side * surfaces.length) / 2 + column * side;
      this._show(this.surfaces[k], [left, (height - side) / 2], side, light, 1);
    });
  }

  /** A surface as ImageData, size x size, under the studio's light. */
  image(k, size) {
    const { gl } = this;
    if (!this.thumbnail || this.thumbnail.size !== size) {
      const texture = gl.createTexture(), target = gl.createFramebuffer();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, size, size);
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      this.thumbnail = { size, target };
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.thumbnail.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    this._show(this.surfaces[k], [0, 0], size, { lamp: null, exposure: 1 }, -1); // rows from the top
    const pixels = new Uint8ClampedArray(4 * size * size);
    gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    for (let k4 = 0; k4 < pixels.length; k4 += 4) { // ImageData is not premultiplied
      const alpha = pixels[k4 + 3];
      if (alpha > 0 && alpha < 255) {
        for (let c = 0; c < 3; c++) pixels[k4 + c] = (pixels[k4 + c] * 255) / alpha;
      }
    }
    return new ImageData(pixels, size, size);
  }

  _show(surface, corner, side, light, flip) {
    const { gl } = this;
    this._use(this.show, surface);
    gl.viewport(...corner.map(Math.round), Math.round(side), Math.round(side));
    bindTexture(gl, this.show, "lit", 1, surface.picture);
    gl.uniform2f(this.show.at("corner"), ...corner.map(Math.round));
    gl.uniform1f(this.show.at("side"), Math.round(side));
    gl.uniform1f(this.show.at("exposure"), light.exposure);
    gl.uniform1f(this.show.at("flip"), flip);
    gl.uniform1i(this.show.at("isLamp"), light.lamp ? 1 : 0);
    gl.uniform3f(this.show.at("lamp"), ...(light.lamp ?? [0, 0, 1]));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  _use(program, surface) {
    const { gl, data } = this, [h, d, p] = data.grid.shape;
    gl.useProgram(program.handle);
    bindTexture(gl, program, "table", 0, surface.table.picture);
    gl.uniform3f(program.at("nodes"), p, d, h);
    gl.uniform3f(program.at("view"), ...data.light.view);
    gl.uniform1f(program.at("thetaHMax"), data.grid.thetaHMax);
    gl.uniform1f(program.at("thetaHPower"), data.grid.thetaHPower);
    gl.uniform1f(program.at("thetaDShare"), data.grid.thetaDShare);
  }
}
