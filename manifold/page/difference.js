// The difference of two pictures, pixel by pixel: CIEDE2000 as a display shows them, and in colours.

import { COLOUR } from "./colour.js";

const STOPS = [[0, 68, 1, 84], [1, 59, 82, 139], [2, 33, 145, 140], [5, 94, 201, 98], [10, 253, 231, 37]]; // CIEDE2000, sRGB
const stopOf = ([, ...rgb]) => `vec3(${rgb.map((v) => (v / 255).toFixed(4)).join(", ")})`;
const ramp = STOPS.slice(1).map((stop, k) => `if (d > ${STOPS[k][0]}.0) c = mix(${stopOf(STOPS[k])}, ${stopOf(stop)},
    min((d - ${STOPS[k][0]}.0) / ${stop[0] - STOPS[k][0]}.0, 1.0));`).join("\n  ");

/** Differences of pictures `one` and `other` (encoded sRGB, coverage): in colours, or where isRaw, as numbers. */
export const DIFFERENCE = `${COLOUR}
uniform sampler2D one, other;
uniform vec2 corner;
uniform bool isRaw;
out vec4 result;

void main() {
  ivec2 within = ivec2(floor(gl_FragCoord.xy - corner)), size = textureSize(one, 0);
  result = vec4(0.0);
  if (any(lessThan(within, ivec2(0))) || any(greaterThanEqual(within, size))) return;
  vec4 p = texelFetch(one, within, 0), q = texelFetch(other, within, 0);
  if (p.a < 0.99) return; // edges are mixed with what is behind them
  float d = deltaE2000Lab(toLab(srgbToXyz(decodeSrgb(p.rgb))), toLab(srgbToXyz(decodeSrgb(q.rgb))));
  vec3 c = ${stopOf(STOPS[0])};
  ${ramp}
  result = isRaw ? vec4(d, d, d, 1.0) : vec4(c, 1.0);
}`;
