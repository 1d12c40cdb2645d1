// A material under an environment or a lamp, in WebGL2, from one table of cube roots per prediction.
//
// Seen from afar, what a surface shows depends on its normal alone, so it is lit on a disc of normals, where shapes look
// theirs up. The light is summed over half vectors, on grids of normals, by tables of the arriving light; at rest, those
// nearest to the normal, which make sharp highlights, are summed for every pixel of the disc. Textures bend the normal from point
// to point, change the colour, and have flakes between, whose facets are lit like another material.

import { BlendRenderer } from "./blend.js";
import { COLOUR } from "./colour.js";
import { DIFFERENCE } from "./difference.js";
import { floorOf, groundPicture, GROUND_REACH, SHAPES_ON_GROUND } from "./ground.js";
import { NORMALS, SHAPES } from "./shapes.js";
import { bindTexture, drawInto, makeCube, makePattern, makeProgram, makeTarget, makeTexture } from "./webgl.js";

// Grids of normals about the direction of the viewer, and the half vectors that light them, in rings of spokes, from
// span[0] to span[1]: the square of that is their angle as a share of 90 degrees.
const WIDE = { azimuths: 48, elevations: 24, rings: 18, spokes: 16, span: [1 / 3, 1] };
const MIDDLE = { azimuths: 128, elevations: 64, rings: 5, spokes: 20, span: [1 / 6, 1 / 3] };
const NEAR = { azimuths: 72, elevations: 36, rings: 6, spokes: 12, span: [0, 1 / 3] }; // while something moves
const TURNING = { // the same while the light turns, whose tables are then made in every frame
  wide: { azimuths: 24, elevations: 12, rings: 12, spokes: 12, span: WIDE.span },
  narrow: { azimuths: 48, elevations: 28, rings: 6, spokes: 9, span: NEAR.span },
};
const FINE = { elevations: 48, rings: 5, spokes: 9, span: [0, 1 / 6] }; // at rest, for every pixel
const MOVING = 160, RESTING = 432; // pixels across discs
const ACROSS = 16; // grids of normals beside each other in a table of light
const STRIPS = 16; // in which a disc at rest is drawn, one per frame
const FACE = 128; // texels along a face of an environment
const MOST_SAMPLES = 4; // of textures across a pixel, at rest; while something moves one, from mipmaps
const SHARE = 0.84; // of a picture's height that a shape's square takes: the rest is ground

/** Pixels along the square of a shape in a picture of some size, of which there are so many beside each other. */
export const squareIn = (width, height, columns) => SHARE * Math.min(height, width / columns);

const COMMON = `
uniform sampler2D table; // cube roots of f cos(theta_i) cos(theta_o): phi_d across, theta_d within theta_h down
uniform vec3 nodes, view;
uniform float thetaHMax, thetaHPower, thetaDShare;
const float PI = 3.14159265358979;
out vec4 result;

vec3 fCosines(sampler2D table, float thetaH, float cosD, float phiD) {
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

// Tangents and normal, in the world, of a normal (right, up, towards the viewer); the viewer is over the first tangent.
mat3 frameOf(vec3 seen) {
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  vec3 normal = seen.x * right + seen.y * up + seen.z * view;
  vec2 outwards = seen.xy / max(length(seen.xy), 1e-6);
  vec3 tangent = length(seen.xy) * view - seen.z * (outwards.x * right + outwards.y * up);
  return mat3(tangent, cross(normal, tangent), normal);
}

float phiDifference(vec3 w, float thetaH, float phiH) {
  float x = cos(thetaH) * (w.x * cos(phiH) + w.y * sin(phiH)) - sin(thetaH) * w.z;
  return atan(w.y * cos(phiH) - w.x * sin(phiH), x);
}
`;

// Half vectors in rings from u = span.x to span.y, at 90 degrees u^2: densest around the normal.
const HALF_VECTORS = `
uniform int rings, spokes;
uniform vec2 span;
struct Half { float theta, phi, area; vec3 m; };

Half halfVector(float ring, float spoke) {
  float u = span.x + ring / float(rings) * (span.y - span.x);
  Half h;
  h.theta = 0.5 * PI * u * u;
  h.phi = 2.0 * PI * (spoke / float(spokes) + 0.6180339887498949 * floor(ring));
  h.area = sin(h.theta) * PI * u * (span.y - span.x) / float(rings) * 2.0 * PI / float(spokes);
  h.m = vec3(sin(h.theta) * cos(h.phi), sin(h.theta) * sin(h.phi), cos(h.theta));
  return h;
}

vec3 viewerAt(float elevation) { // as a share of 90 degrees
  float theta = clamp(elevation, 1e-3, 0.985) * 0.5 * PI;
  return vec3(sin(theta), 0.0, cos(theta));
}
`;

const SKY = `
uniform samplerCube environment;
uniform mat3 turned; // from the world to the environment
const float TEXEL = ${((4 * Math.PI) / (6 * FACE * FACE)).toFixed(10)}; // its solid angle

vec3 skyAt(vec3 world, float solidAngle) {
  return textureLod(environment, turned * world, 0.5 * log2(max(solidAngle / TEXEL, 1.0))).rgb;
}
`;

// An environment's rows and columns as a face of a cube.
const FACES = `
uniform sampler2D picture;
uniform mat3 axes; // right, down, ahead
out vec4 result;
void main() {
  vec2 at = gl_FragCoord.xy / ${FACE}.0 * 2.0 - 1.0;
  vec3 w = normalize(axes * vec3(at, 1.0));
  vec2 look = vec2(atan(w.x, w.y) / 6.28318530717959, acos(clamp(w.z, -1.0, 1.0)) / 3.14159265358979);
  result = vec4(textureLod(picture, look, 0.0).rgb, 1.0);
}`;

// The light that arrives through each wide half vector's cell, at each normal of the grid: whatever the material.
const LIGHT = `${COMMON}${HALF_VECTORS}${SKY}
uniform int finer; // parts of a cell, each way
uniform ivec2 grid; // azimuths, elevations
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), tile = at / grid;
  int index = tile.x + ${ACROSS} * tile.y;
  result = vec4(0.0);
  if (index >= rings * spokes) return;
  vec2 place = vec2(at - tile * grid);
  vec3 wi = viewerAt(place.y / float(grid.y - 1));
  float azimuth = 2.0 * PI * (place.x + 0.5) / float(grid.x), n = float(finer);
  mat3 frame = frameOf(vec3(wi.x * cos(azimuth), wi.x * sin(azimuth), wi.z));
  vec2 cell = vec2(index / spokes, index % spokes);
  for (int k = 0; k < finer * finer; k++) {
    Half h = halfVector(cell.x + (float(k / finer) + 0.5) / n, cell.y + (float(k % finer) + 0.5) / n);
    float cosine = dot(wi, h.m);
    vec3 wo = 2.0 * cosine * h.m - wi;
    if (cosine <= 0.0 || wo.z <= 0.0) continue;
    float solidAngle = 4.0 * cosine * h.area / (n * n);
    result.rgb += solidAngle * skyAt(frame * wo, solidAngle);
  }
}`;

// f cos(theta_o) at each half vector and elevation; where isWhole, times the solid angle of its cell above the horizon.
const MATERIAL = `${COMMON}${HALF_VECTORS}
uniform float rows;
uniform bool isWhole;
void main() {
  int index = int(gl_FragCoord.x);
  Half h = halfVector(float(index / spokes) + 0.5, float(index % spokes) + 0.5);
  vec3 wi = viewerAt((gl_FragCoord.y - 0.5) / (rows - 1.0));
  float cosine = dot(wi, h.m), up = 2.0 * cosine * h.m.z - wi.z;
  result = vec4(0.0);
  if (cosine <= 0.0 || (isWhole && up <= 0.0)) return;
  vec3 f = fCosines(table, h.theta, cosine, phiDifference(wi, h.theta, h.phi)) / wi.z;
  result = vec4(clamp(isWhole ? f * 4.0 * cosine * h.area : f, 0.0, 6e4), 0.0);
}`;

const SUM = `
uniform sampler2D material, light;
uniform int count;
uniform ivec2 grid;
out vec4 result;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < count; k++) {
    sum += texelFetch(material, ivec2(k, at.y), 0).rgb
      * texelFetch(light, at + ivec2(k % ${ACROSS}, k / ${ACROSS}) * grid, 0).rgb;
  }
  result = vec4(sum, 1.0);
}`;

// The disc of normals: what the grids have and, at rest, the half vectors nearest to the normal one by one.
const DISC = `${COMMON}${HALF_VECTORS}${SKY}
uniform sampler2D wide, narrow, material;
uniform float size;
uniform bool isMoving;

// Where a picture has an elevation: its first row is the normal, its last the horizon.
float rowOf(float elevation, sampler2D picture) {
  float rows = float(textureSize(picture, 0).y);
  return (elevation * (rows - 1.0) + 0.5) / rows;
}

void main() {
  vec2 place = (gl_FragCoord.xy / size * 2.0 - 1.0) * 1.02;
  float radius = length(place);
  result = vec4(0.0);
  if (radius > 1.02 + 4.0 / size) return;
  place *= min(1.0, 0.999 / max(radius, 1e-6));
  vec3 seen = vec3(place, sqrt(1.0 - dot(place, place)));
  float theta = acos(seen.z) / (0.5 * PI);
  float azimuth = atan(place.y, place.x) / (2.0 * PI);
  vec3 wi = vec3(length(place), 0.0, seen.z);
  vec3 sum = textureLod(wide, vec2(azimuth, rowOf(theta, wide)), 0.0).rgb;
  sum += textureLod(narrow, vec2(azimuth, rowOf(theta, narrow)), 0.0).rgb;
  float row = rowOf(theta, material);
  result = vec4(sum, 1.0);
  if (isMoving) return;
  mat3 frame = turned * frameOf(seen);
  float grazing = 0.5 * log2(4.0 * max(seen.z, 0.05) / TEXEL);
  vec2 next = vec2(cos(2.0 * PI / float(spokes)), sin(2.0 * PI / float(spokes)));
  int index = 0;
  for (int ring = 0; ring < rings; ring++) {
    Half h = halfVector(float(ring) + 0.5, 0.5);
    float lod = max(grazing + 0.5 * log2(h.area), 0.0);
    vec3 m = h.m;
    for (int spoke = 0; spoke < spokes; spoke++) {
      vec3 contribution = textureLod(material, vec2((float(index++) + 0.5) / float(rings * spokes), row), 0.0).rgb;
      vec3 wo = 2.0 * dot(wi, m) * m - wi;
      sum += contribution * textureLod(environment, frame * wo, lod).rgb;
      m.xy = vec2(m.x * next.x - m.y * next.y, m.x * next.y + m.y * next.x);
    }
  }
  result = vec4(sum, 1.0);
}`;

const SHOW = `${COMMON}${COLOUR}
uniform sampler2D disc, normals, ground;
uniform vec2 corner;
uniform float exposure, side;
uniform bool isLamp, isOnGround;
uniform vec3 lamp; // towards the lamp: right, up, towards the viewer
uniform vec3 onFloor; // reflectance of the floor
uniform vec2 standing; // height of the shape's middle, and radius of the ball whose shadow stands for its own
uniform mat3 turned; // from the world to the environment

// What the floor shows at a place of the picture (right and up, radii).
vec3 floorAt(vec2 place) {
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  vec3 p = place.x * right + place.y * up;
  p -= (p.z + standing.x) / view.z * view;
  if (!isLamp) return onFloor * textureLod(ground, (turned * p).xy / ${(2 * GROUND_REACH).toFixed(1)} + 0.5, 0.0).rgb;
  vec3 wo = lamp.x * right + lamp.y * up + lamp.z * view;
  float away = length(p), sine = min(standing.y / away, 1.0);
  float seen = clamp(0.5 + (sqrt(1.0 - sine * sine) + dot(p, wo) / away) / (0.07 * sine), 0.0, 1.0);
  return onFloor * max(wo.z, 0.0) * seen;
}

// What a facet of a material shows whose normal is seen (right, up, towards the viewer).
vec3 radianceOf(sampler2D table, sampler2D disc, vec3 seen) {
  if (!isLamp) return textureLod(disc, seen.xy / 1.02 * 0.5 + 0.5, 0.0).rgb;
  mat3 frame = frameOf(seen);
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  vec3 wi = view * frame, wo = (lamp.x * right + lamp.y * up + lamp.z * view) * frame;
  if (wo.z <= 0.0) return vec3(0.0);
  vec3 h = normalize(wi + wo);
  float thetaH = atan(length(h.xy), h.z), phiH = atan(h.y, h.x);
  return PI * fCosines(table, thetaH, dot(wi, h), phiDifference(wi, thetaH, phiH)) / wi.z;
}

#ifdef TEXTURED
// A normal that faces the viewer, however it was bent.
vec3 facing(vec3 normal) { return normalize(vec3(normal.xy, max(normal.z, 0.045))); }

uniform sampler2D places, colours, reliefs, flakes, flakesTable, flakesDisc;
uniform vec3 brightest; // colour, over the mean, of the texels of value 1
uniform float share; // of a flake's texel that its facet covers
uniform int most; // samples across a pixel

// What textures show at a place of the picture: the mean of as many samples as texels lie across a pixel.
vec3 textured(vec3 normal, vec4 place) {
  vec3 along = normalize(vec3(place.zw, -dot(place.zw, normal.xy) / normal.z)), up = cross(normal, along);
  mat3 tangent = mat3(along, up, normal);
  float pixel = 2.04 / side / PI;
  vec2 slant = -normal.xy / normal.z;
  vec2 dx = pixel * vec2(1.0, -1.0) * (vec3(1.0, 0.0, slant.x) * tangent).xy;
  vec2 dy = pixel * vec2(1.0, -1.0) * (vec3(0.0, 1.0, slant.y) * tangent).xy;
  vec2 size = vec2(textureSize(colours, 0));
  int n = clamp(int(size.x * max(length(dx), length(dy)) + 0.5), 1, most);
  dx /= float(n);
  dy /= float(n);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < n * n; k++) {
    vec2 offset = vec2(k % n, k / n) + 0.5 - 0.5 * float(n);
    vec2 at = fract(place.xy + 0.5 + offset.x * dx + offset.y * dy);
    vec3 relief = textureGrad(reliefs, at, dx, dy).xyz * 2.0 - 1.0;
    vec3 here = brightest * textureGrad(colours, at, dx, dy).rgb * radianceOf(table, disc, facing(tangent * relief));
    vec3 flake = texelFetch(flakes, ivec2(at * size), 0).xyz; // normal (x, y), and the share of the texel
    if (share > 0.0 && flake.z > 0.0) {
      flake.xy = flake.xy * 2.0 - 1.0;
      vec3 facet = vec3(flake.xy, sqrt(max(1.0 - dot(flake.xy, flake.xy), 0.0)));
      here = mix(here, radianceOf(flakesTable, flakesDisc, facing(tangent * facet)), share * flake.z);
    }
    sum += here;
  }
  return sum / float(n * n);
}
#endif

// Less than a step of 8 bits, so that smooth shading has no bands.
float dither() { return (fract(sin(dot(gl_FragCoord.xy, vec2(12.9898, 78.233))) * 43758.5453) - 0.5) / 255.0; }

void main() {
  ivec2 within = ivec2(floor(gl_FragCoord.xy - corner)), size = textureSize(normals, 0);
  bool isInside = all(greaterThanEqual(within, ivec2(0))) && all(lessThan(within, size));
  vec4 normal = isInside ? texelFetch(normals, within, 0) : vec4(0.0);
  result = vec4(0.0);
  vec3 behind = vec3(0.0);
  if (isOnGround && normal.a < 1.0) behind = encodeSrgb(floorAt(((gl_FragCoord.xy - corner) / side * 2.0 - 1.0) * 1.02) * exposure);
  if (normal.a <= 0.0) {
    if (isOnGround) result = vec4(behind + dither(), 1.0);
    return;
  }
#ifdef TEXTURED
  vec3 linear = textured(normal.xyz, texelFetch(places, within, 0));
#else
  vec3 linear = radianceOf(table, disc, normal.xyz);
#endif
  result = vec4(mix(behind, encodeSrgb(linear * exposure), normal.a) + (isOnGround ? dither() : 0.0), 1.0);
  if (!isOnGround) result = vec4(encodeSrgb(linear * exposure) * normal.a, normal.a);
}`;

const PROGRAMS = { faces: FACES, light: LIGHT, material: MATERIAL, sum: SUM, disc: DISC, normals: NORMALS, show: SHOW };
const FACE_AXES = [ // right, down, ahead of each face of a cube, as WebGL has them
  [[0, 0, -1], [0, -1, 0], [1, 0, 0]], [[0, 0, 1], [0, -1, 0], [-1, 0, 0]], [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
  [[1, 0, 0], [0, 0, -1], [0, -1, 0]], [[1, 0, 0], [0, -1, 0], [0, 0, 1]], [[-1, 0, 0], [0, -1, 0], [0, 0, -1]],
];
/** The finest disc that a surface has. */
const discOf = ({ isRefined, resting, moving }) => (isRefined ? resting : moving).picture;

/** Where the lit facets of a surface's flakes are kept. */
const flakesOf = (k) => `flakes of ${k}`;

/** The light of the pictures of materials on the map. */
export const PLAIN = { environment: 0, turn: 0 };
const PLAIN_KEY = JSON.stringify([0, 0]);

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
    this.gl = gl;
    this.data = materials.data;
    this.environments = materials.environments;
    this.blends = new BlendRenderer(gl, materials);
    this.programs = Object.fromEntries(Object.entries(PROGRAMS).map(([name, fragment]) => [name, makeProgram(gl, fragment)]));
    this.cubes = [];
    this.lights = new Map(); // by set of half vectors, then by environment and turn: that of PLAIN, and the last
    this.room = new Map(); // for what materials make of sets of half vectors
    this.grounds = new Map(); // by environment and shape
    this.shapes = new Map(); // pictures of normals: the last, and that of thumbnails
    this.textures = new Map(); // of surfaces, in WebGL
    this.surfaces = {}; // by number, and their flakes
  }

  /**
   * Take a prediction under an illuminant as surface 0, 1, ..., and light it coarsely, still more so where the light alone
   * was turned; light is {environment, turn}.
   */
  setSurface(k, prediction, illuminant, light, isTurning = false) {
    const { blends, gl } = this, grid = ({ azimuths, elevations }) => makeTarget(gl, azimuths, elevations);
    const disc = (size) => makeTarget(gl, size, size, { wrap: gl.CLAMP_TO_EDGE });
    this.surfaces[k] ??= { table: blends.table(), wide: grid(WIDE), narrow: grid(NEAR), middle: grid(MIDDLE),
      turning: { wide: grid(TURNING.wide), narrow: grid(TURNING.narrow) }, moving: disc(MOVING), resting: disc(RESTING) };
    const surface = this.surfaces[k], isBlended = surface.prediction === prediction && surface.illuminant === illuminant;
    Object.assign(surface, { prediction, illuminant, light, isRefined: false });
    if (!isBlended) blends.draw(surface.table, prediction, illuminant, true); // turning the light keeps the material
    const sets = isTurning ? TURNING : { wide: WIDE, narrow: NEAR }, grids = isTurning ? surface.turning : surface;
    this._sum(surface, grids.wide, sets.wide, 1);
    this._sum(surface, grids.narrow, sets.narrow, 1);
    this._drawDisc(surface, surface.moving, grids, null, 0, MOVING);
    const flakes = prediction.textures?.flakes;
    if (flakes) this.setSurface(flakesOf(k), flakes.facet, illuminant, light, isTurning);
  }

  /** Blend and light a surface again, as finely as befits a still picture. */
  refine(k) {
    for (const _ of this.refining(k)) continue;
  }

  /** The same, a strip at a time. */
  *refining(k) {
    const surface = this.surfaces[k];
    if (!surface || surface.isRefined) return;
    this.blends.draw(surface.table, surface.prediction, surface.illuminant, false);
    this._sum(surface, surface.wide, WIDE, 3);
    this._sum(surface, surface.middle, MIDDLE, 2);
    const contribution = this._contribution(surface, FINE), high = RESTING / STRIPS;
    for (let row = 0; row < RESTING; row += high) {
      this._drawDisc(surface, surface.resting, { wide: surface.wide, narrow: surface.middle }, contribution, row, high);
      yield;
    }
    if (surface.prediction.textures?.flakes) yield* this.refining(flakesOf(k));
    surface.isRefined = true;
  }

  /** An environment as a cube, made when first asked for. */
  _cube(index) {
    if (this.cubes[index]) return this.cubes[index];
    const { gl, programs: { faces } } = this, { rows, columns, radiance } = this.environments[index];
    const rgba = new Float32Array(4 * rows * columns);
    for (let k = 0; k < rows * columns; k++) for (let c = 0; c < 3; c++) rgba[4 * k + c] = radiance[3 * k + c];
    const picture = makeTexture(gl, columns, rows, rgba), cube = makeCube(gl, FACE);
    gl.useProgram(faces.handle);
    bindTexture(gl, faces, "picture", 0, picture);
    FACE_AXES.forEach((axes, face) => {
      gl.uniformMatrix3fv(faces.at("axes"), false, axes.flat());
      drawInto(gl, { target: cube.targets[face], width: FACE, height: FACE });
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_CUBE_MAP, cube.picture);
    gl.generateMipmap(gl.TEXTURE_CUBE_MAP);
    gl.deleteTexture(picture);
    return (this.cubes[index] = cube);
  }

  /** The table of the light through half vectors, their cells in parts each way: made where there is none as fine. */
  _light(light, set, finer) {
    const key = JSON.stringify([light.environment, light.turn]), { gl, programs: { light: program } } = this;
    const kept = this.lights.get(set) ?? this.lights.set(set, new Map()).get(set);
    let made = kept.get(key);
    if (made?.finer >= finer) return made.picture;
    if (!made) {
      const last = [...kept.keys()].find((other) => other !== PLAIN_KEY);
      const rows = Math.ceil((set.rings * set.spokes) / ACROSS);
      made = (key !== PLAIN_KEY && kept.get(last)) || makeTarget(gl, set.azimuths * ACROSS, set.elevations * rows);
      if (key !== PLAIN_KEY) kept.delete(last);
      kept.set(key, made);
    }
    gl.useProgram(program.handle);
    gl.uniform3f(program.at("view"), ...this.data.view);
    gl.uniform1i(program.at("finer"), finer);
    gl.uniform2i(program.at("grid"), set.azimuths, set.elevations);
    this._setHalfVectors(program, set);
    this._bindSky(program, light);
    drawInto(gl, made);
    return Object.assign(made, { finer }).picture;
  }

  _setHalfVectors(program, { rings, spokes, span }) {
    this.gl.uniform1i(program.at("rings"), rings);
    this.gl.uniform1i(program.at("spokes"), spokes);
    this.gl.uniform2f(program.at("span"), ...span);
  }

  _bindSky(program, { environment, turn }) {
    const { gl } = this, [c, s] = [Math.cos(turn), Math.sin(turn)], cube = this._cube(environment);
    gl.useProgram(program.handle); // making a cube used another
    gl.activeTexture(gl.TEXTURE3);
    gl.bindTexture(gl.TEXTURE_CUBE_MAP, cube.picture);
    gl.uniform1i(program.at("environment"), 3);
    gl.uniformMatrix3fv(program.at("turned"), false, [c, -s, 0, s, c, 0, 0, 0, 1]);
  }

  /** What a surface's material makes of light along half vectors, a column each, at elevations. */
  _contribution(surface, set) {
    const { gl, programs: { material } } = this, { elevations, rings, spokes } = set;
    if (!this.room.has(set)) this.room.set(set, makeTarget(gl, rings * spokes, elevations, { wrap: gl.CLAMP_TO_EDGE }));
    this._use(material, surface);
    this._setHalfVectors(material, set);
    gl.uniform1i(material.at("isWhole"), set === FINE ? 1 : 0);
    gl.uniform1f(material.at("rows"), elevations);
    drawInto(gl, this.room.get(set));
    return this.room.get(set).picture;
  }

  /** Light a grid of normals along a set of half vectors. */
  _sum(surface, grid, set, finer) {
    const { gl, programs: { sum } } = this, light = this._light(surface.light, set, finer);
    const contribution = this._contribution(surface, set);
    gl.useProgram(sum.handle);
    bindTexture(gl, sum, "material", 0, contribution);
    bindTexture(gl, sum, "light", 1, light);
    gl.uniform1i(sum.at("count"), set.rings * set.spokes);
    gl.uniform2i(sum.at("grid"), set.azimuths, set.elevations);
    drawInto(gl, grid);
  }

  /** Draw rows of a disc of normals, from the wide and a narrower grid, and contributions of single half vectors, if any. */
  _drawDisc(surface, disc, { wide, narrow }, contribution, row, high) {
    const { gl, programs: { disc: program } } = this, size = disc.width;
    this._bindSky(program, surface.light);
    bindTexture(gl, program, "wide", 0, wide.picture);
    bindTexture(gl, program, "narrow", 1, narrow.picture);
    bindTexture(gl, program, "material", 2, contribution ?? narrow.picture);
    gl.uniform3f(program.at("view"), ...this.data.view);
    gl.uniform1f(program.at("size"), size);
    gl.uniform1i(program.at("isMoving"), contribution ? 0 : 1);
    this._setHalfVectors(program, FINE);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, row, size, high);
    drawInto(gl, disc);
    gl.disable(gl.SCISSOR_TEST);
  }

  /** Pictures of a shape's normals, and of its places on textures, side pixels wide. */
  _normals(shape, turn, side, flip) {
    const use = flip > 0 ? "shown" : "thumbnail", key = `${shape} ${turn} ${side}`, { gl, programs: { normals } } = this;
    const made = this.shapes.get(use);
    if (made?.key === key) return made;
    if (made) {
      for (const picture of [made.picture, made.places]) gl.deleteTexture(picture);
      gl.deleteFramebuffer(made.target);
    }
    const target = makeTarget(gl, side, side), places = makeTexture(gl, side, side, null);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT1, gl.TEXTURE_2D, places, 0);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    gl.useProgram(normals.handle);
    gl.uniform3f(normals.at("view"), ...this.data.view);
    gl.uniform1i(normals.at("shape"), SHAPES.indexOf(shape));
    for (const [name, value] of Object.entries({ side, turn, flip })) gl.uniform1f(normals.at(name), value);
    drawInto(gl, target);
    this.shapes.set(use, { ...target, places, key });
    return this.shapes.get(use);
  }

  /**
   * Draw surfaces side by side, each in a square; light is {lamp: null or direction, exposure, shape, turnShape}. With a
   * share of the width as `wipe`, two surfaces share one square: the first to the left of it, the second to the right.
   */
  draw(surfaces, light, wipe = null) {
    const { gl } = this, { width, height } = gl.canvas, columns = wipe === null ? surfaces.length : 1;
    const side = Math.floor(squareIn(width, height, columns)), across = width / columns;
    const corners = surfaces.map((_, k) => [(wipe === null ? k * across : 0) + (across - side) / 2, (height - side) / 2].map(Math.round));
    const normals = this._normals(light.shape, light.turnShape, side, 1);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.viewport(0, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    surfaces.forEach((k, column) => {
      const at = Math.round(wipe === null ? across : corners[0][0] + wipe * side);
      if (surfaces.length === 1) gl.scissor(0, 0, width, height);
      else if (column === 0) gl.scissor(0, 0, at, height);
      else gl.scissor(at, 0, width - at, height);
      this._show(k, normals, corners[column], side, light, this._ground(this.surfaces[k].light, light.shape));
    });
    gl.disable(gl.SCISSOR_TEST);
  }

  /** Pixels along the square of a single shape in the picture. */
  get side() {
    return Math.floor(squareIn(this.gl.canvas.width, this.gl.canvas.height, 1));
  }

  /** Draw where two surfaces differ, in colours, in the square of one; light as of `draw`. */
  drawDifference(surfaces, light) {
    const { gl, side } = this, { width, height } = gl.canvas;
    this._compared(surfaces, light, side);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.viewport(0, 0, width, height);
    this._difference([width, height].map((v) => Math.round((v - side) / 2)), false);
  }

  /** Mean and largest CIEDE2000 between two surfaces, over pixels of a small picture. */
  difference(surfaces, light) {
    const { gl } = this, size = 96, values = new Float32Array(4 * size * size);
    this._compared(surfaces, light, size);
    const { target } = (this.measured ??= makeTarget(gl, size, size));
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, size, size);
    this._difference([0, 0], true);
    gl.readPixels(0, 0, size, size, gl.RGBA, gl.FLOAT, values);
    const found = values.filter((_, k) => k % 4 === 0 && values[k + 3] > 0);
    return { mean: found.reduce((sum, v) => sum + v, 0) / found.length, most: found.reduce((most, v) => Math.max(most, v), 0) };
  }

  /** Pictures of two surfaces without ground, side x side, for `_difference`. */
  _compared(surfaces, light, side) {
    const { gl } = this;
    if (this.compared?.side !== side) {
      for (const { picture, target } of this.compared?.targets ?? []) {
        gl.deleteTexture(picture);
        gl.deleteFramebuffer(target);
      }
      this.compared = { side, targets: surfaces.map(() => makeTarget(gl, side, side)) };
    }
    const normals = this._normals(light.shape, light.turnShape, side, 1);
    surfaces.forEach((k, at) => {
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.compared.targets[at].target);
      gl.viewport(0, 0, side, side);
      this._show(k, normals, [0, 0], side, light);
    });
  }

  _difference(corner, isRaw) {
    const { gl, compared: { targets } } = this, program = (this.programs.difference ??= makeProgram(gl, DIFFERENCE));
    gl.useProgram(program.handle);
    bindTexture(gl, program, "one", 0, targets[0].picture);
    bindTexture(gl, program, "other", 1, targets[1].picture);
    gl.uniform2f(program.at("corner"), ...corner);
    gl.uniform1i(program.at("isRaw"), isRaw ? 1 : 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** A surface's ball as ImageData, size x size. */
  image(k, size) {
    const { gl } = this;
    if (this.thumbnail?.size !== size) {
      const texture = gl.createTexture(), target = gl.createFramebuffer();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, size, size);
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      this.thumbnail = { size, target };
    }
    const normals = this._normals("ball", 0, size, -1); // rows from the top
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.thumbnail.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.viewport(0, 0, size, size);
    this._show(k, normals, [0, 0], size, { lamp: null, exposure: 1 });
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

  /** The ground of an environment with the shadow of a shape, made when first asked for. */
  _ground({ environment, turn }, shape) {
    const key = `${environment} ${shape}`, [c, s] = [Math.cos(turn), Math.sin(turn)], standing = SHAPES_ON_GROUND[shape];
    if (!this.grounds.has(key)) {
      const { side, values } = groundPicture(this.environments[environment], standing);
      this.grounds.set(key, makeTexture(this.gl, side, side, values, { wrap: this.gl.CLAMP_TO_EDGE }));
    }
    return { picture: this.grounds.get(key), standing: [standing.height, standing.radius], turned: [c, -s, 0, s, c, 0, 0, 0, 1],
      onFloor: floorOf(this.environments[environment]) };
  }

  /** Draw a surface by a shape's normals into a square; on the ground, if any, over all that the scissors let. */
  _show(k, normals, corner, side, light, ground = null) {
    const { gl, surfaces: { [k]: surface } } = this, isTextured = Boolean(surface.prediction.textures);
    const show = isTextured ? (this.programs.textured ??= makeProgram(gl, `\n#define TEXTURED${SHOW}`)) : this.programs.show;
    this._use(show, surface);
    if (isTextured) this._bindTextures(show, k, normals.places);
    gl.uniform1i(show.at("isOnGround"), ground ? 1 : 0);
    gl.uniform1f(show.at("side"), side);
    bindTexture(gl, show, "ground", 4, ground?.picture ?? normals.picture);
    if (ground) {
      gl.uniform3f(show.at("onFloor"), ...ground.onFloor);
      gl.uniform2f(show.at("standing"), ...ground.standing);
      gl.uniformMatrix3fv(show.at("turned"), false, ground.turned);
    }
    bindTexture(gl, show, "disc", 1, discOf(surface));
    bindTexture(gl, show, "normals", 2, normals.picture);
    gl.uniform2f(show.at("corner"), ...corner);
    gl.uniform1f(show.at("exposure"), light.exposure);
    gl.uniform1i(show.at("isLamp"), light.lamp ? 1 : 0);
    gl.uniform3f(show.at("lamp"), ...(light.lamp ?? [0, 0, 1]));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Let the program in use read a surface's textures, and its flakes as they are lit. */
  _bindTextures(program, k, places) {
    const { gl, surfaces: { [k]: surface, [flakesOf(k)]: lit } } = this, { textures } = surface.prediction;
    if (!this.textures.has(textures)) {
      this.textures.set(textures, {
        colours: makePattern(gl, textures.colours, gl.SRGB8_ALPHA8), reliefs: makePattern(gl, textures.normals, gl.RGBA8),
        flakes: textures.flakes && makePattern(gl, textures.flakes.picture, gl.RGBA8),
      });
    }
    const { colours, reliefs, flakes } = this.textures.get(textures), shown = flakes ? lit : surface;
    Object.entries({ places, colours, reliefs, flakes: flakes ?? colours, flakesTable: shown.table.picture, flakesDisc: discOf(shown) })
      .forEach(([name, picture], unit) => bindTexture(gl, program, name, 5 + unit, picture));
    gl.uniform3f(program.at("brightest"), ...textures.brightest);
    gl.uniform1f(program.at("share"), textures.flakes?.share ?? 0);
    gl.uniform1i(program.at("most"), surface.isRefined ? MOST_SAMPLES : 1);
  }

  _use(program, surface) {
    const { gl, data } = this, [h, d, p] = data.grid.shape;
    gl.useProgram(program.handle);
    bindTexture(gl, program, "table", 0, surface.table.picture);
    gl.uniform3f(program.at("nodes"), p, d, h);
    gl.uniform3f(program.at("view"), ...data.view);
    gl.uniform1f(program.at("thetaHMax"), data.grid.thetaHMax);
    gl.uniform1f(program.at("thetaHPower"), data.grid.thetaHPower);
    gl.uniform1f(program.at("thetaDShare"), data.grid.thetaDShare);
  }
}
