// Splatting as pipeline/rendering/splat_conventions.py defines it, front to back.
import { GAUSSIAN, HEAD } from "./gaussian.js";

/**
 * A parallelogram around each footprint. With c = M M^T + dilation I, q = h^2 + e^2 is linear in the corner: h runs along
 * y in units of sqrt(c_yy), e along x in units of sqrt(det / c_yy), sheared by c_xy / c_yy.
 */
const FOOTPRINT = `
uniform mat3 m_R;
uniform vec3 t, center;
uniform vec2 focal, principal, size;
uniform float dilation, near;
uniform int i_compensate;
out vec2 corner;
flat out float opacity;
const float MIN_ALPHA = 1.0 / 255.0, FRUSTUM_MARGIN = 0.3;

/* Pixel of a corner, or outside of everything. */
vec3 placed(Gaussian g) {
  vec3 nothing = vec3(-9e9, -9e9, -1.0);
  vec3 p = m_R * g.mean + t;
  opacity = g.opacity;
  if (p.z < near || opacity < MIN_ALPHA) return nothing;
  vec2 slope = p.xy / p.z, margin = FRUSTUM_MARGIN * 0.5 * size / focal;
  vec2 kept = clamp(slope, -principal / focal - margin, (size - principal) / focal + margin);
  mat3 turned = m_R * g.axes;
  vec3 x = vec3(turned[0].x, turned[1].x, turned[2].x), y = vec3(turned[0].y, turned[1].y, turned[2].y);
  vec3 z = vec3(turned[0].z, turned[1].z, turned[2].z);
  vec3 a = focal.x / p.z * (x - kept.x * z) * g.scales, b = focal.y / p.z * (y - kept.y * z) * g.scales;
  vec3 minors = cross(a, b);
  float area2 = dot(minors, minors), aa = dot(a, a), bb = dot(b, b);
  float determinant = area2 + dilation * (aa + bb) + dilation * dilation, c_yy = bb + dilation;
  if (i_compensate != 0) opacity *= sqrt(area2 / determinant);
  if (opacity < MIN_ALPHA) return nothing;
  corner = (2.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) - 1.0) * sqrt(2.0 * log(opacity / MIN_ALPHA) + 1e-4);
  float dy = corner.y * sqrt(c_yy), dx = dot(a, b) / c_yy * dy + corner.x * sqrt(determinant / c_yy);
  return vec3(slope * focal + principal + vec2(dx, dy), p.z);
}
`;

const ALPHA = `
in vec2 corner;
flat in float opacity;
float covered() { return min(0.999, opacity * exp(-0.5 * dot(corner, corner))); }
`;

/** Splats of one instance. A GPU starts an instance for its own sake; software GL takes 40 microseconds for each. */
export const BATCH = 256;

export const SPLAT_VERTEX = `${HEAD}${GAUSSIAN}${FOOTPRINT}
uniform sampler2D t_colors;
uniform usampler2D t_order;
uniform int i_count;
flat out vec3 shade;
void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  int rank = gl_InstanceID * ${BATCH} + (gl_VertexID >> 2);
  if (rank >= i_count) return;
  int i = int(texelFetch(t_order, at(rank), 0).r);
  Gaussian g = gaussian(i);
  if (dot(g.face, center - g.mean) <= 0.0) return;
  vec3 pixel = placed(g);
  if (pixel.z < 0.0) return;
  shade = texelFetch(t_colors, at(i), 0).rgb;
  gl_Position = vec4(2.0 * pixel.xy / size - 1.0, 0.0, 1.0);
}
`;

/** Blended by the light that is left, alpha: color += left alpha shade, left *= 1 - alpha. */
export const SPLAT_FRAGMENT = `${HEAD}${ALPHA}
flat in vec3 shade;
out vec4 color;
void main() {
  float alpha = covered();
  if (alpha < 1.0 / 255.0) discard;
  color = vec4(alpha * shade, alpha);
}
`;

/** Filters samples down to pixels, puts what is behind, and encodes for the display. */
export const DISPLAY = `${HEAD}
uniform sampler2D t_image, t_sky;
uniform float taps[16];
uniform int i_taps, i_factor, i_encoded, i_sky;
uniform mat3 m_R;
uniform vec2 focal, principal, size;
uniform vec3 backdrop;
uniform float exposure, sky_turn, sky_gain;
out vec4 color;

vec3 behind(vec2 pixel) {
  if (i_sky == 0) return backdrop;
  vec3 ray = normalize(transpose(m_R) * vec3((pixel - principal) / focal, 1.0));
  float around = atan(ray.x, -ray.z) + sky_turn;
  vec2 at = vec2(fract(around / 6.283185307179586), acos(clamp(ray.y, -1.0, 1.0)) / 3.141592653589793);
  return exposure * sky_gain * textureLod(t_sky, at, 0.0).rgb;
}

vec3 encoded(vec3 c) {
  return mix(12.92 * c, 1.055 * pow(max(c, 0.0031308), vec3(1.0 / 2.4)) - 0.055, vec3(greaterThan(c, vec3(0.0031308))));
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
  vec3 sum = vec3(0.0);
  float left = 0.0;
  for (int y = 0; y < i_taps; y++) for (int x = 0; x < i_taps; x++) {
    vec4 part = taps[x] * taps[y] * texelFetch(t_image, i_factor * pixel + ivec2(x, y), 0);
    sum += part.rgb;
    left += part.a;
  }
  vec3 back = behind(vec2(pixel) + 0.5);
  if (i_encoded != 0) color = vec4(sum + left * encoded(back), 1.0);
  else color = vec4(encoded(clamp(exposure * sum + left * back, 0.0, 1.0)), 1.0);
}
`;
