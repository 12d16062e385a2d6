// Light of every Gaussian: coated Lambert, one bounce and GGX, as matte.py, bounces.py and microfacet.py of
// pipeline/lighting have them.
import { GAUSSIAN, HEAD } from "./gaussian.js";

/** Lamps with what hides each: bits that were traced for the frame, bits that the page traced, or nothing. */
const LIGHTS = `
uniform sampler2D t_lights;
uniform usampler2D t_seen, t_placed;
uniform int i_lights, i_count;
const float PI = 3.141592653589793;
const int PLACED = 1 << 20;

struct Light { vec3 position, intensity; int bit; };

Light lamp(int j) {
  vec4 a = texelFetch(t_lights, ivec2(0, j), 0), b = texelFetch(t_lights, ivec2(1, j), 0);
  return Light(a.xyz, b.rgb, int(a.w));
}

/* Bits from PLACED on are of lamps that are placed in the page. */
float visible(Light light, int i) {
  if (light.bit < 0) return 1.0;
  uint word = light.bit < PLACED ? texelFetch(t_seen, at((light.bit >> 5) * i_count + i), 0).r : texelFetch(t_placed, at(i), 0).r;
  return float((word >> (light.bit & 31)) & 1u);
}
`;

/** Diffuse light of the lamps, and the share of their light that arrives. */
export const DIFFUSE = `${HEAD}${GAUSSIAN}${LIGHTS}
out vec4 color;
void main() {
  int i = int(gl_FragCoord.x) + (int(gl_FragCoord.y) << 10);
  if (i >= i_count) { color = vec4(0.0); return; }
  Gaussian g = gaussian(i);
  Matter m = matter(i);
  vec3 arriving = vec3(0.0), sent = vec3(0.0);
  for (int j = 0; j < i_lights; j++) {
    Light light = lamp(j);
    vec3 offset = light.position - g.mean;
    float along = dot(offset, g.normal);
    if (along <= 0.0) continue;
    float distance2 = max(dot(offset, offset), 1e-8);
    float distance = sqrt(distance2);
    vec3 falling = light.intensity * (along / (distance2 * distance) * passes(along / distance, m.coat));
    sent += falling;
    arriving += falling * visible(light, i);
  }
  const vec3 LUMINANCE = vec3(0.2126, 0.7152, 0.0722);
  float full = dot(sent, LUMINANCE);
  color = vec4(m.albedo / PI * arriving, full > 0.0 ? dot(arriving, LUMINANCE) / full : 0.0);
}
`;

/** Light of white by way of the texels that traced rays hit. */
export const BOUNCE = `${HEAD}${GAUSSIAN}
uniform sampler2D t_diffuse;
uniform usampler2D t_starts, t_hits;
uniform int i_count;
uniform float rays;
out vec4 color;
void main() {
  int i = int(gl_FragCoord.x) + (int(gl_FragCoord.y) << 10);
  if (i >= i_count) { color = vec4(0.0); return; }
  int first = int(texelFetch(t_starts, at(i), 0).r), end = int(texelFetch(t_starts, at(i + 1), 0).r);
  vec3 sum = vec3(0.0);
  for (int k = first; k < end; k++)
    sum += max(texelFetch(t_diffuse, at(int(texelFetch(t_hits, at(k), 0).r)), 0).rgb, 0.0);
  color = vec4(sum / rays, 1.0);
}
`;

/** The mean of that over a texel and those around it, which share their rays. */
export const SHARED = `${HEAD}${GAUSSIAN}
uniform sampler2D t_gathered;
uniform usampler2D t_adjoining;
uniform int i_count;
out vec4 color;
void main() {
  int i = int(gl_FragCoord.x) + (int(gl_FragCoord.y) << 10);
  if (i >= i_count) { color = vec4(0.0); return; }
  vec4 sum = vec4(0.0);
  for (int k = 0; k < 9; k++) {
    int j = int(texelFetch(t_adjoining, at(9 * i + k), 0).r);
    if (j < i_count) sum += texelFetch(t_gathered, at(j), 0);
  }
  color = vec4(matter(i).albedo * sum.rgb / sum.a, 1.0);
}
`;

/** The layer that is shown, towards one camera: gloss, and what it is added to. */
export const LAYER = `${HEAD}${GAUSSIAN}${LIGHTS}
uniform sampler2D t_diffuse, t_bounce;
uniform vec3 center;
uniform int i_layer;
const float F0 = 0.04, LEAST = 1e-4;
out vec4 color;

vec3 gloss(int i, Gaussian g, Matter m) {
  vec3 sum = vec3(0.0), toward = normalize(center - g.mean);
  float co = dot(g.normal, toward), a2 = m.width * m.width;
  if (co <= LEAST || m.gloss <= 0.0) return sum;
  for (int j = 0; j < i_lights; j++) {
    Light light = lamp(j);
    vec3 offset = light.position - g.mean;
    float inverse2 = 1.0 / max(dot(offset, offset), 1e-8);
    vec3 w = offset * sqrt(inverse2);
    float ci = dot(g.normal, w);
    if (ci <= LEAST) continue;
    vec3 both = w + toward;
    float size = sqrt(max(dot(both, both), 1e-12));
    vec3 h = both / size, across = cross(g.normal, h);
    float ch = dot(g.normal, h), t = a2 * ch * ch + dot(across, across);
    float d = a2 / (PI * t * t);
    float fresnel = F0 + (1.0 - F0) * pow(max(1.0 - 0.5 * size, 0.0), 5.0);
    float masked = 0.5 / (ci * sqrt(a2 + (1.0 - a2) * co * co) + co * sqrt(a2 + (1.0 - a2) * ci * ci));
    sum += light.intensity * (visible(light, i) * d * fresnel * masked * ci * inverse2);
  }
  return m.gloss * sum;
}

void main() {
  int i = int(gl_FragCoord.x) + (int(gl_FragCoord.y) << 10);
  if (i >= i_count) { color = vec4(0.0); return; }
  Gaussian g = gaussian(i);
  Matter m = matter(i);
  float leaving = passes(dot(g.normal, normalize(center - g.mean)), m.coat);
  vec4 diffuse = texelFetch(t_diffuse, at(i), 0) * vec4(vec3(leaving), 1.0);
  vec3 bounce = texelFetch(t_bounce, at(i), 0).rgb * leaving;
  if (i_layer == 0) color.rgb = diffuse.rgb + bounce + gloss(i, g, m);
  else if (i_layer == 1) color.rgb = m.albedo;
  else if (i_layer == 2) color.rgb = 0.5 + 0.5 * g.normal;
  else if (i_layer == 3) color.rgb = diffuse.rgb;
  else if (i_layer == 4) color.rgb = gloss(i, g, m);
  else if (i_layer == 5) color.rgb = vec3(diffuse.a);
  else color.rgb = bounce;
  color.a = 1.0;
}
`;
