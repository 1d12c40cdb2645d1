// The difference of two pictures, pixel by pixel: CIEDE2000 as a display shows them (Sharma et al. 2005), and in colours.

const STOPS = [[0, 68, 1, 84], [1, 59, 82, 139], [2, 33, 145, 140], [5, 94, 201, 98], [10, 253, 231, 37]]; // CIEDE2000, sRGB
const stopOf = ([, ...rgb]) => `vec3(${rgb.map((v) => (v / 255).toFixed(4)).join(", ")})`;
const ramp = STOPS.slice(1).map((stop, k) => `if (d > ${STOPS[k][0]}.0) c = mix(${stopOf(STOPS[k])}, ${stopOf(stop)},
    min((d - ${STOPS[k][0]}.0) / ${stop[0] - STOPS[k][0]}.0, 1.0));`).join("\n  ");

/** Differences of pictures `one` and `other` (encoded sRGB, coverage): in colours, or where isRaw, as numbers. */
export const DIFFERENCE = `
uniform sampler2D one, other;
uniform vec2 corner;
uniform bool isRaw;
const float DEGREE = 0.017453292519943;
out vec4 result;

vec3 labOf(vec3 encoded) {
  vec3 c = mix(encoded / 12.92, pow((encoded + 0.055) / 1.055, vec3(2.4)), step(0.04045, encoded));
  vec3 t = vec3(dot(c, vec3(0.4124564, 0.3575761, 0.1804375)) / 0.9504700, dot(c, vec3(0.2126729, 0.7151522, 0.0721750)),
    dot(c, vec3(0.0193339, 0.1191920, 0.9503041)) / 1.0888300);
  vec3 f = mix(t / 0.12841855 + 4.0 / 29.0, pow(max(t, 1e-9), vec3(1.0 / 3.0)), step(0.008856452, t));
  return vec3(116.0 * f.y - 16.0, 500.0 * (f.x - f.y), 200.0 * (f.y - f.z));
}

float hueOf(vec2 ab) { float h = atan(ab.y, ab.x); return dot(ab, ab) == 0.0 ? 0.0 : h < 0.0 ? h + 360.0 * DEGREE : h; }

float ciede2000(vec3 p, vec3 q) {
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

void main() {
  ivec2 within = ivec2(floor(gl_FragCoord.xy - corner)), size = textureSize(one, 0);
  result = vec4(0.0);
  if (any(lessThan(within, ivec2(0))) || any(greaterThanEqual(within, size))) return;
  vec4 p = texelFetch(one, within, 0), q = texelFetch(other, within, 0);
  if (p.a < 0.99) return; // edges are mixed with what is behind them
  float d = ciede2000(labOf(p.rgb), labOf(q.rgb));
  vec3 c = ${stopOf(STOPS[0])};
  ${ramp}
  result = isRaw ? vec4(d, d, d, 1.0) : vec4(c, 1.0);
}`;
