// A Gaussian from its textures; see pipeline/viewer/shown_frame.py for the tables.

export const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
`;

export const GAUSSIAN = `
uniform usampler2D t_place, t_shape, t_matter;
uniform vec3 low, high;
uniform vec2 log_scales;

ivec2 at(int i) { return ivec2(i & 1023, i >> 10); }
vec2 levels(uint pair) { return vec2(pair & 65535u, pair >> 16) / 65535.0; }

vec3 unfolded(uint pair) {
  vec2 p = 2.0 * levels(pair) - 1.0;
  vec3 n = vec3(p, 1.0 - abs(p.x) - abs(p.y));
  if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  return normalize(n);
}

mat3 rotation(vec4 q) {
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

struct Gaussian { vec3 mean; float opacity; mat3 axes; vec3 scales, normal, face; };

Gaussian gaussian(int i) {
  uvec4 place = texelFetch(t_place, at(i), 0), shape = texelFetch(t_shape, at(i), 0);
  vec2 xy = levels(place.x), zo = levels(place.y), s = levels(shape.x);
  vec4 q = 2.0 * vec4(levels(place.z), levels(place.w)) - 1.0;
  Gaussian g;
  g.mean = low + (high - low) * vec3(xy, zo.x);
  g.opacity = zo.y;
  g.axes = rotation(normalize(q));
  g.scales = exp(log_scales.x + (log_scales.y - log_scales.x) * vec3(s, levels(shape.y).x));
  g.normal = g.axes * unfolded(shape.z);
  g.face = g.axes * unfolded(shape.w);
  return g;
}

struct Matter { vec3 albedo; float width, gloss, coat; };

Matter matter(int i) {
  uvec4 m = texelFetch(t_matter, at(i), 0);
  vec2 rg = unpackHalf2x16(m.x), bw = unpackHalf2x16(m.y), gc = unpackHalf2x16(m.z);
  return Matter(vec3(rg, bw.x), bw.y, gc.x, gc.y);
}

/* Share of diffuse light that gets past the coat at an angle, see pipeline/lighting/matte.py. */
float passes(float cosine, float coat) { return 1.0 - coat * pow(1.0 - clamp(cosine, 0.0, 1.0), 2.5); }
`;

/** A triangle over the whole target. */
export const WHOLE = `${HEAD}
void main() { gl_Position = vec4(4.0 * float(gl_VertexID & 1) - 1.0, 2.0 * float(gl_VertexID & 2) - 1.0, 0.0, 1.0); }
`;
