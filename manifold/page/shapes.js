// Shapes that show a material, as pictures of normals, on which alone their light depends, far from all lights; and of places
// on a surface's textures.

export const SHAPES = ["ball", "cloth", "box"];

/**
 * Normals (right, up, towards the viewer) and coverage of a shape over a square of 1.02 radii each way; and places on textures that
 * repeat every pi radii, without a half of that, with the tangent (right, up) along which the first grows.
 */
export const NORMALS = `
uniform vec3 view;
uniform int shape; // its index in SHAPES
uniform float side, turn, flip;
layout(location = 0) out vec4 result;
layout(location = 1) out vec4 place;
const float PI = 3.14159265358979;

float distanceToCloth(vec3 p) { // over a ball, in folds that deepen downwards
  float down = max(0.32 - p.z, 0.0), round_ = atan(p.y, p.x);
  float fold = 0.16 * smoothstep(0.0, 1.0, down) * (cos(7.0 * round_ + 0.8 * sin(2.0 * round_)) + 0.3 * sin(4.0 * round_ + 1.0));
  float wide = 0.5 + 0.26 * down * down + fold;
  float around = length(vec3(p.xy, max(p.z - 0.32, 0.0))) - wide;
  return max(around, -0.78 - p.z);
}

float distanceToBox(vec3 p) {
  vec3 q = abs(p) - 0.4;
  return length(max(q, 0.0)) + min(max(q.x, max(q.y, q.z)), 0.0) - 0.14;
}

float distanceTo(vec3 p) { return shape == 1 ? 0.55 * distanceToCloth(p) : distanceToBox(p); }

// Where a point with a normal is on the textures, in radii, right and down, and the tangent along which the first grows.
vec2 unrolled(vec3 p, vec3 normal, out vec3 tangent) {
  if (shape == 1) { // as of a flat cloth that was laid over the ball
    float down = p.z - 0.32 > 0.0 ? 0.5 * acos((p.z - 0.32) / length(vec3(p.xy, p.z - 0.32))) : 0.25 * PI + 0.32 - p.z;
    vec2 outwards = p.xy / max(length(p.xy), 1e-6);
    vec3 around = vec3(-outwards.y, outwards.x, 0.0);
    tangent = outwards.x * cross(around, normal) - outwards.y * around;
    return down * vec2(outwards.x, -outwards.y);
  }
  vec3 a = abs(p), s = sign(p);
  if (a.z >= max(a.x, a.y)) {
    tangent = vec3(1.0, 0.0, 0.0);
    return vec2(p.x, -p.y);
  }
  tangent = a.x > a.y ? vec3(0.0, s.x, 0.0) : vec3(-s.y, 0.0, 0.0);
  return vec2(dot(p, tangent), -p.z);
}

void main() {
  vec2 at = (gl_FragCoord.xy / side * 2.0 - 1.0) * 1.02;
  at.y *= flip;
  float radius = length(at);
  if (shape == 0) { // columns from left to right, rows from pole to pole
    at *= min(1.0, 0.999 / max(radius, 1e-6));
    vec3 n = vec3(at, sqrt(1.0 - dot(at, at)));
    result = vec4(n, clamp((1.0 - radius) * side / 3.0 + 0.5, 0.0, 1.0));
    place = vec4(atan(n.x, n.z) / PI, acos(n.y) / PI - 0.5, n.z / max(length(n.xz), 1e-6), 0.0);
    return;
  }
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  mat3 turned = mat3(cos(turn), -sin(turn), 0.0, sin(turn), cos(turn), 0.0, 0.0, 0.0, 1.0);
  vec3 start = at.x * right + at.y * up;
  float along = 1.02, nearest = 1.0;
  vec3 p;
  for (int step = 0; step < 64 && along > -1.02; step++) {
    p = turned * (start + along * view);
    float apart = distanceTo(p);
    nearest = min(nearest, apart);
    if (apart < 1e-3) break;
    along -= apart;
  }
  const vec2 e = vec2(2e-3, 0.0);
  vec3 own = normalize(vec3(distanceTo(p + e.xyy) - distanceTo(p - e.xyy), distanceTo(p + e.yxy) - distanceTo(p - e.yxy),
    distanceTo(p + e.yyx) - distanceTo(p - e.yyx))), normal = own * turned, tangent;
  place.xy = unrolled(p, own, tangent) / PI;
  tangent = normalize(tangent - dot(tangent, own) * own) * turned;
  place.zw = vec2(dot(tangent, right), dot(tangent, up));
  vec3 seen = vec3(dot(normal, right), dot(normal, up), max(dot(normal, view), 0.045));
  result = vec4(normalize(seen), clamp(1.0 - nearest * side / 3.0, 0.0, 1.0));
}`;
