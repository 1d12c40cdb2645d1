// CIELAB under D65 of linear sRGB, and reflectances tinted to a colour. No page is touched here.

const TO_XYZ = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.072175], [0.0193339, 0.119192, 0.9503041]];
const WHITE = TO_XYZ.map((row) => row[0] + row[1] + row[2]);
const LEAST = 1e-3, FARTHEST = 7, STEPS_TO_COLOUR = 30; // as in manifold/completion/attributes.py
const DEGREES = 180 / Math.PI;

/** CIELAB of linear sRGB. */
export function labOf(linear) {
  const [x, y, z] = TO_XYZ.map((row, c) => {
    const t = row.reduce((sum, v, k) => sum + v * linear[k], 0) / WHITE[c];
    return t > (6 / 29) ** 3 ? Math.cbrt(t) : t / (3 * (6 / 29) ** 2) + 4 / 29;
  });
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
}

/** Lightness, chroma and hue in degrees of CIELAB. */
export const lchOf = ([l, a, b]) => [l, Math.hypot(a, b), (Math.atan2(b, a) * DEGREES + 360) % 360];

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
export const labOfLch = ([l, c, h]) => [l, c * Math.cos(h / DEGREES), c * Math.sin(h / DEGREES)];

/** Linear sRGB of values (J) at nodes, by rows (J, 3). */
export const linearOf = (values, toSrgb) => [0, 1, 2].map((c) => values.reduce((sum, v, j) => sum + v * toSrgb[j][c], 0));

/** sRGB of linear sRGB, as #rrggbb. */
export const hexOf = (linear) => `#${linear.map((v) => {
  const c = Math.min(Math.max(v, 0), 1);
  const encoded = c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055;
  return Math.round(255 * encoded).toString(16).padStart(2, "0");
}).join("")}`;

/** A reflectance (J) brought to a CIELAB colour by gains that are smooth, or as near as they come: `tinted` of attributes.py. */
export function tinted(reflectance, lab, toSrgb, primaries) {
  const base = reflectance.map((v) => Math.max(v, LEAST));
  const gained = (a) => base.map((v, j) => v * Math.exp(a.reduce((sum, w, c) => sum + w * primaries[c][j], 0)));
  const off = (a) => labOf(linearOf(gained(a), toSrgb)).map((v, k) => v - lab[k]);
  const size = (v) => Math.hypot(...v);
  let a = [0, 0, 0], now = off(a), damping = 1e-3;
  for (let step = 0; step < STEPS_TO_COLOUR && size(now) > 1e-3; step++) { // Levenberg-Marquardt
    const columns = [0, 1, 2].map((c) => off(a.map((v, k) => v + (k === c ? 1e-4 : 0))).map((v, k) => (v - now[k]) / 1e-4));
    const dot = (u, v) => u.reduce((sum, w, k) => sum + w * v[k], 0);
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
