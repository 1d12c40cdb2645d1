// @NAME@
//
// A measured BRDF in linear sRGB. GLSL ES 3.00 and later, without its version line. Directions are unit vectors in
// the local frame, where z is the normal: wi towards the viewer, wo towards the light.
//
//   vec3  manifold_eval(vec3 wi, vec3 wo)    f cos(theta_o) in 1/sr, 0 below the horizon. Colours outside of sRGB
//                                            have negative components: clamp the sum over all lights
//   vec4  manifold_sample(vec2 u, vec3 wi)   a direction wo for uniform numbers u, and its density; 0 if it is invalid
//   float manifold_pdf(vec3 wi, vec3 wo)     the density of manifold_sample in 1/sr
//
// The table is manifold.ktx2: half floats, linear filter, clamped, no mipmaps. Define MANIFOLD_TABLE as another
// sampler2D to bind it differently. Evaluation reads six texels, filtered; sampling and its density read none.

precision highp float;
precision highp int;

#ifndef MANIFOLD_TABLE
uniform highp sampler2D manifold_table;
#define MANIFOLD_TABLE manifold_table
#endif

@CONSTANTS@

const float MANIFOLD_PI = 3.14159265358979;

// The incidence below a direction, and the weight of the next one.
float manifold_incidence(vec3 wi, out int lower) {
  float theta = atan(length(wi.xy), wi.z);
  lower = 0;
  for (int t = 1; t < MANIFOLD_INCIDENCES - 1; t++) lower = theta >= MANIFOLD_THETA[t] ? t : lower;
  float low = MANIFOLD_THETA[lower], high = MANIFOLD_THETA[lower + 1];
  return clamp((theta - low) / (high - low), 0.0, 1.0);
}

// The texels of a block of incidence t at coordinates in [0, 1].
vec3 manifold_block(int t, vec2 at, ivec2 nodes, int first_row) {
  int across = MANIFOLD_SIZE.x / nodes.x;
  vec2 corner = vec2((t % across) * nodes.x, first_row + (t / across) * nodes.y);
  vec2 texel = corner + 0.5 + clamp(at, 0.0, 1.0) * vec2(nodes - 1);
  return textureLod(MANIFOLD_TABLE, texel / vec2(MANIFOLD_SIZE), 0.0).rgb;
}

// Normal distribution and projected area at an elevation in radians.
vec2 manifold_normals(float theta) {
  float texel = 0.5 + sqrt(clamp(theta * 2.0 / MANIFOLD_PI, 0.0, 1.0)) * float(MANIFOLD_NODES - 1);
  return textureLod(MANIFOLD_TABLE, vec2(texel, float(MANIFOLD_NORMAL_ROW) + 0.5) / vec2(MANIFOLD_SIZE), 0.0).rg;
}

vec3 manifold_eval(vec3 wi, vec3 wo) {
  if (min(wi.z, wo.z) <= 0.0) return vec3(0.0);
  int t;
  float share = manifold_incidence(wi, t);
  vec3 m = wi + wo;
  float theta_m = atan(length(m.xy), m.z);
  vec2 ahead = dot(wi.xy, wi.xy) > 0.0 ? wi.xy : vec2(1.0, 0.0);
  float y = dot(m.xy, m.xy) > 0.0 ? atan(ahead.x * m.y - ahead.y * m.x, dot(ahead, m.xy)) / (2.0 * MANIFOLD_PI) : 0.0;
  vec2 at = vec2(sqrt(theta_m * 2.0 / MANIFOLD_PI), fract(y + 0.5));
  vec3 sums = mix(manifold_block(t, at, MANIFOLD_SUMS, 0), manifold_block(t + 1, at, MANIFOLD_SUMS, 0), share);
  at = vec2(sums.x / max(sums.y, 1e-7), sums.z);
  vec3 value = mix(manifold_block(t, at, MANIFOLD_VALUES, MANIFOLD_VALUE_ROW),
    manifold_block(t + 1, at, MANIFOLD_VALUES, MANIFOLD_VALUE_ROW), share);
  float area = manifold_normals(atan(length(wi.xy), wi.z)).y;
  return value * (MANIFOLD_FACTOR * manifold_normals(theta_m).x / area);
}

// Weights of the cosine and of two lobes at an incidence.
vec3 manifold_weights(vec3 wi) {
  int t;
  float share = manifold_incidence(wi, t);
  return mix(MANIFOLD_WEIGHTS[t], MANIFOLD_WEIGHTS[t + 1], share);
}

// The share of the cap of reflections below the horizon that a lobe samples.
// Source: Eto & Tokuyoshi 2023, Bounded VNDF sampling for Smith-GGX reflections, equation 5.
float manifold_bound(vec3 wi, float alpha) {
  float a2 = alpha * alpha, s = 1.0 + length(wi.xy), s2 = s * s;
  return (1.0 - a2) * s2 / (s2 + a2 * wi.z * wi.z);
}

float manifold_lobe_pdf(vec3 wi, vec3 wo, float alpha) {
  vec3 m = wi + wo;
  float a2 = alpha * alpha, spread = (dot(m.xy, m.xy) / a2 + m.z * m.z) / max(dot(m, m), 1e-20);
  float size = sqrt(a2 * dot(wi.xy, wi.xy) + wi.z * wi.z);
  return 1.0 / (MANIFOLD_PI * a2 * spread * spread * 2.0 * (manifold_bound(wi, alpha) * wi.z + size));
}

vec3 manifold_lobe(vec2 u, vec3 wi, float alpha) {
  vec3 stretched = normalize(vec3(wi.xy * alpha, wi.z));
  float bound = manifold_bound(wi, alpha) * stretched.z, z = (1.0 - u.y) * (1.0 + bound) - bound;
  float phi = 2.0 * MANIFOLD_PI * u.x, sine = sqrt(max(1.0 - z * z, 0.0));
  vec3 m = stretched + vec3(sine * cos(phi), sine * sin(phi), z);
  m.xy *= alpha;
  float size = length(m);
  m = size > 0.0 ? m / size : vec3(0.0, 0.0, 1.0); // 0 where a reflection grazes
  return 2.0 * dot(wi, m) * m - wi;
}

float manifold_pdf(vec3 wi, vec3 wo) {
  if (min(wi.z, wo.z) <= 0.0) return 0.0;
  vec3 weights = manifold_weights(wi);
  return weights.x * wo.z / MANIFOLD_PI + weights.y * manifold_lobe_pdf(wi, wo, MANIFOLD_ALPHAS.x)
    + weights.z * manifold_lobe_pdf(wi, wo, MANIFOLD_ALPHAS.y);
}

vec4 manifold_sample(vec2 u, vec3 wi) {
  vec3 weights = manifold_weights(wi), wo;
  if (u.x < weights.x) {
    float phi = 2.0 * MANIFOLD_PI * u.x / weights.x;
    wo = vec3(sqrt(u.y) * vec2(cos(phi), sin(phi)), sqrt(1.0 - u.y));
  } else if (u.x < weights.x + weights.y) {
    wo = manifold_lobe(vec2((u.x - weights.x) / weights.y, u.y), wi, MANIFOLD_ALPHAS.x);
  } else {
    float last = max(1.0 - weights.x - weights.y, 1e-9);
    wo = manifold_lobe(vec2(min((u.x - weights.x - weights.y) / last, 1.0), u.y), wi, MANIFOLD_ALPHAS.y);
  }
  return vec4(wo, manifold_pdf(wi, wo));
}
