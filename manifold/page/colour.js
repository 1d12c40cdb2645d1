// Colours, as in manifold/colour/conversion.py and difference.py, and in manifold/estimate/attributes.py: formulas are named as
// there, in JavaScript and, at the end, in GLSL. No page is touched here.

const SRGB_TO_XYZ = [
  [0.412390799, 0.357584339, 0.180480788], [0.212639006, 0.715168679, 0.072192315], [0.019330819, 0.11919478, 0.950532152],
];
const WHITE = SRGB_TO_XYZ.map((row) => row[0] + row[1] + row[2]);
const LUMINANCE = SRGB_TO_XYZ[1];
const LEAST = 1e-3, FARTHEST = 7, STEPS_TO_COLOUR = 30; // of a reflectance, of gains' logarithms, of a search
const DEGREES = 180 / Math.PI;
const dot = (u, v) => u.reduce((sum, w, k) => sum + w * v[k], 0);

/** Display values of linear sRGB, one channel. */
export function encodeSrgb(linear) {
  const c = Math.min(Math.max(linear, 0), 1);
  return c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055;
}

/** Linear sRGB of display values, one channel. */
export const decodeSrgb = (display) => (display <= 12.92 * 0.0031308 ? display / 12.92 : ((display + 0.055) / 1.055) ** 2.4);

export const srgbToXyz = (linear) => SRGB_TO_XYZ.map((row) => dot(row, linear));

/** The luminance of linear sRGB. */
export const luminance = (linear) => dot(LUMINANCE, linear);

/** CIELAB of XYZ under D65. */
export function toLab(xyz) {
  const [x, y, z] = xyz.map((v, c) => {
    const t = v / WHITE[c];
    return t > (6 / 29) ** 3 ? Math.cbrt(t) : t / (3 * (6 / 29) ** 2) + 4 / 29;
  });
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
}

/** CIELAB under D65 of a reflectance factor (J). */
export const labOfFactor = (factor, toSrgb) => toLab(srgbToXyz(linearOf(factor, toSrgb)));

/** Lightness, chroma and hue in degrees of CIELAB. */
export const toLch = ([l, a, b]) => [l, Math.hypot(a, b), (Math.atan2(b, a) * DEGREES + 360) % 360];

const HUES = { // degrees in CIELAB that people give a name, from and to; names overlap
  pink: [335, 15], red: [10, 52], orange: [45, 80], yellow: [72, 118], green: [108, 195], turquoise: [170, 235], blue: [220, 312],
  purple: [295, 350],
};

/** Words for a colour (lightness, chroma, hue) and gloss units at 60 degrees, as people search by them. */
export function wordsFor([lightness, chroma, hue], gloss) {
  const words = [gloss < 10 ? "matt" : gloss < 70 ? "satin" : "glossy"];
  if (lightness < 35) words.push("dark");
  if (lightness > 70) words.push("light");
  if (chroma < 12) words.push(lightness > 80 ? "white" : lightness < 25 ? "black" : "grey");
  if (chroma >= 6) {
    for (const [name, [from, to]] of Object.entries(HUES)) if ((hue - from + 360) % 360 <= (to - from + 360) % 360) words.push(name);
    if (lightness < 60 && hue > 35 && hue < 90 && chroma < 55) words.push("brown");
  }
  return words;
}

/** CIELAB of lightness, chroma and hue. */
export const fromLch = ([l, c, h]) => [l, c * Math.cos(h / DEGREES), c * Math.sin(h / DEGREES)];

/** Linear sRGB of values (J) at nodes, by rows (J, 3). */
const linearOf = (values, toSrgb) => [0, 1, 2].map((c) => values.reduce((sum, v, j) => sum + v * toSrgb[j][c], 0));

/** sRGB of linear sRGB, as #rrggbb. */
export const hexOf = (linear) =>
  `#${linear.map((v) => Math.round(255 * encodeSrgb(v)).toString(16).padStart(2, "0")).join("")}`;

/** A reflectance (J) brought to a CIELAB colour by gains that are smooth, or as near as they come. */
export function tinted(reflectance, lab, toSrgb, primaries) {
  const base = reflectance.map((v) => Math.max(v, LEAST));
  const gained = (a) => base.map((v, j) => v * Math.exp(a.reduce((sum, w, c) => sum + w * primaries[c][j], 0)));
  const off = (a) => labOfFactor(gained(a), toSrgb).map((v, k) => v - lab[k]);
  const size = (v) => Math.hypot(...v);
  let a = [0, 0, 0], now = off(a), damping = 1e-3;
  for (let step = 0; step < STEPS_TO_COLOUR && size(now) > 1e-3; step++) { // Levenberg-Marquardt
    const columns = [0, 1, 2].map((c) => off(a.map((v, k) => v + (k === c ? 1e-4 : 0))).map((v, k) => (v - now[k]) / 1e-4));
    const normal = columns.map((u, i) => columns.map((v, j) => dot(u, v) * (i === j ? 1 + damping : 1)));
    const move = solve3(normal, columns.map((u) => -dot(u, now)));
    const next = a.map((v, k) => Math.min(Math.max(v + move[k], -FARTHEST), FARTHEST)), then = off(next);
    if (size(then) < size(now)) [a, now, damping] = [next, then, damping / 4];
    else damping *= 8;
  }
  return gained(a);
}

/** The solution of three equations, by Cramer's rule. */
function solve3(m, v) {
  const determinant = (p) => p[0][0] * (p[1][1] * p[2][2] - p[1][2] * p[2][1]) - p[0][1] * (p[1][0] * p[2][2] - p[1][2] * p[2][0])
    + p[0][2] * (p[1][0] * p[2][1] - p[1][1] * p[2][0]);
  const whole = determinant(m) || 1e-30;
  return [0, 1, 2].map((c) => determinant(m.map((row, r) => row.map((w, k) => (k === c ? v[r] : w)))) / whole);
}

const vec3 = (values) => `vec3(${values.map((v) => v.toFixed(9)).join(", ")})`;

/** The same in GLSL, and CIEDE2000 of two colours in CIELAB (Sharma et al. 2005). */
export const COLOUR = `
const float DEGREE = 0.017453292519943;

vec3 encodeSrgb(vec3 linear) {
  vec3 c = clamp(linear, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}

vec3 decodeSrgb(vec3 display) {
  return mix(display / 12.92, pow((display + 0.055) / 1.055, vec3(2.4)), step(12.92 * 0.0031308, display));
}

vec3 srgbToXyz(vec3 linear) { return vec3(${SRGB_TO_XYZ.map((row) => `dot(linear, ${vec3(row)})`).join(", ")}); }

vec3 toLab(vec3 xyz) {
  vec3 t = xyz / ${vec3(WHITE)};
  vec3 f = mix(t / 0.12841855 + 4.0 / 29.0, pow(max(t, 1e-9), vec3(1.0 / 3.0)), step(0.008856452, t));
  return vec3(116.0 * f.y - 16.0, 500.0 * (f.x - f.y), 200.0 * (f.y - f.z));
}

float hueOf(vec2 ab) { float h = atan(ab.y, ab.x); return dot(ab, ab) == 0.0 ? 0.0 : h < 0.0 ? h + 360.0 * DEGREE : h; }

float deltaE2000Lab(vec3 p, vec3 q) {
  float mean7 = pow(0.5 * (length(p.yz) + length(q.yz)), 7.0), g = 1.0 + 0.5 * (1.0 - sqrt(mean7 / (mean7 + 6103515625.0)));
  vec2 s = vec2(p.y * g, p.z), t = vec2(q.y * g, q.z);
  float c1 = length(s), c2 = length(t), h1 = hueOf(s), h2 = hueOf(t), turn = h2 - h1, isGrey = c1 * c2 == 0.0 ? 1.0 : 0.0;
  if (abs(turn) > 180.0 * DEGREE) turn -= sign(turn) * 360.0 * DEGREE;
  if (isGrey > 0.0) turn = 0.0;
  float h = isGrey > 0.0 ? h1 + h2 : 0.5 * (h1 + h2);
  if (isGrey == 0.0 && abs(h1 - h2) > 180.0 * DEGREE) h += h < 180.0 * DEGREE ? 180.0 * DEGREE : -180.0 * DEGREE;
  float l = 0.5 * (p.x + q.x) - 50.0, c = 0.5 * (c1 + c2), c7 = pow(c, 7.0);
  float weight = 1.0 - 0.17 * cos(h - 30.0 * DEGREE) + 0.24 * cos(2.0 * h) + 0.32 * cos(3.0 * h + 6.0 * DEGREE)
    - 0.20 * cos(4.0 * h - 63.0 * DEGREE);
  float away = (h / DEGREE - 275.0) / 25.0, rotation = sin(60.0 * DEGREE * exp(-away * away)) * 2.0 * sqrt(c7 / (c7 + 6103515625.0));
  float dl = (q.x - p.x) / (1.0 + 0.015 * l * l / sqrt(20.0 + l * l)), dc = (c2 - c1) / (1.0 + 0.045 * c);
  float dh = 2.0 * sqrt(c1 * c2) * sin(0.5 * turn) / (1.0 + 0.015 * c * weight);
  return sqrt(max(dl * dl + dc * dc + dh * dh - rotation * dc * dh, 0.0));
}
`;
