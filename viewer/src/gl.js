// Thin helpers around WebGL2.

/** Width of textures that hold a list: item i lies in column i mod WIDTH of row i / WIDTH. */
export const WIDTH = 1024;

/** A linked program and its uniforms by name. */
export function makeProgram(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "shader");
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? "program");
  const places = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const name = gl.getActiveUniform(program, i).name;
    places[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
  }
  return { program, places };
}

/** A texture that does not repeat. */
export function makeTexture(gl, filter = gl.NEAREST) {
  const target = gl.TEXTURE_2D;
  const texture = gl.createTexture();
  gl.bindTexture(target, texture);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, name, filter);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
  return texture;
}

/** Uploads a list of 32-bit integers, `channels` to a texel, 1 or 4. */
export function uploadWords(gl, texture, words, channels) {
  const texels = Math.max(1, Math.ceil(words.length / channels));
  const rows = Math.ceil(texels / WIDTH);
  const padded = new Uint32Array(rows * WIDTH * channels);
  padded.set(words);
  const [stored, format] = channels === 4 ? [gl.RGBA32UI, gl.RGBA_INTEGER] : [gl.R32UI, gl.RED_INTEGER];
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, stored, WIDTH, rows, 0, format, gl.UNSIGNED_INT, padded);
}

/** A framebuffer with one colour texture of floats, made anew when its size changes. */
export class Target {
  constructor(gl, format) {
    this.gl = gl;
    this.format = format;
    this.texture = makeTexture(gl);
    this.framebuffer = gl.createFramebuffer();
    this.width = this.height = 0;
  }

  /** Draws go here, to all of it. */
  bind(width, height) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    if (this.width !== width || this.height !== height) {
      [this.width, this.height] = [width, height];
      gl.bindTexture(gl.TEXTURE_2D, this.texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, this.format, width, height, 0, gl.RGBA, gl.FLOAT, null);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
    }
    gl.viewport(0, 0, width, height);
  }
}

/** Sets uniforms by name: t_ are textures, as [unit, texture], i_ integers, m_ matrices, all others floats. */
export function setUniforms(gl, { program, places }, values) {
  gl.useProgram(program);
  for (const [name, value] of Object.entries(values)) {
    const place = places[name];
    if (place === undefined) continue;
    if (name.startsWith("t_")) {
      const [unit, texture] = value;
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(place, unit);
    } else if (name.startsWith("i_")) gl.uniform1i(place, value);
    else if (name.startsWith("m_")) gl.uniformMatrix3fv(place, false, value);
    else if (typeof value === "number") gl.uniform1f(place, value);
    else gl[`uniform${value.length > 4 ? 1 : value.length}fv`](place, value);
  }
}
