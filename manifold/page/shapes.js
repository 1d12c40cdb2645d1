// Shapes that show a material, as pictures of normals: their light depends on nothing else, far from all lights.

export const SHAPES = ["ball", "cloth", "box"];

/** Normals (right, up, towards the viewer) and coverage of a shape over a square of 1.02 radii each way. */
export const NORMALS = `
uniform vec3 view;
uniform int shape; // its index in SHAPES
uniform float side, turn, flip;
out vec4 result;

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

void main() {
  vec2 place = (gl_FragCoord.xy / side * 2.0 - 1.0) * 1.02;
  place.y *= flip;
  float radius = length(place);
  if (shape == 0) {
    place *= min(1.0, 0.999 / max(radius, 1e-6));
    result = vec4(place, sqrt(1.0 - dot(place, place)), clamp((1.0 - radius) * side / 3.0 + 0.5, 0.0, 1.0));
    return;
  }
  vec3 right = normalize(cross(vec3(0.0, 0.0, 1.0), view)), up = cross(view, right);
  mat3 turned = mat3(cos(turn), -sin(turn), 0.0, sin(turn), cos(turn), 0.0, 0.0, 0.0, 1.0);
  vec3 start = place.x * right + place.y * up;
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
  vec3 normal = normalize(vec3(distanceTo(p + e.xyy) - distanceTo(p - e.xyy), distanceTo(p + e.yxy) - distanceTo(p - e.yxy),
    distanceTo(p + e.yyx) - distanceTo(p - e.yyx))) * turned;
  vec3 seen = vec3(dot(normal, right), dot(normal, up), max(dot(normal, view), 0.045));
  result = vec4(normalize(seen), clamp(1.0 - nearest * side / 3.0, 0.0, 1.0));
}`;
