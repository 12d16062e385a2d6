// Draws the avatar: light of every Gaussian into textures, then splats, then the filter down to the display.
import { centerOf } from "./camera.js";
import { makeProgram, makeTexture, setUniforms, Target, uploadWords, WIDTH } from "./gl.js";
import { WHOLE } from "./shaders/gaussian.js";
import { BOUNCE, DIFFUSE, LAYER, SHARED } from "./shaders/lighting.js";
import { BATCH, DISPLAY, SPLAT_FRAGMENT, SPLAT_VERTEX } from "./shaders/splatting.js";

export const LAYERS = ["picture", "albedo", "normals", "diffuse", "specular", "shadow", "bounce"];
const NEAR_M = 0.01;
const CUTOFF = 3;

/** Bits from this on are of lamps that are placed in the page; float32 holds it and what follows exactly. */
export const PLACED = 1 << 20;

/** Weights of the samples of a pixel in one direction; see pipeline/rendering/supersample.py. */
export function filterTaps({ pixel_filter: filter, filter_std_px: std }, factor) {
  if (filter === "box" || factor === 1) return Array(factor).fill(1 / factor);
  const beyond = Math.max(0, Math.ceil(CUTOFF * std * factor - factor / 2));
  const count = factor + 2 * beyond;
  const weights = Array.from({ length: count }, (_, k) => Math.exp(-0.5 * ((k - (count - 1) / 2) / (factor * std)) ** 2));
  const sum = weights.reduce((a, b) => a + b);
  return weights.map((w) => w / sum);
}

/** Columns of a matrix of rows, as uniforms take it. */
const columns = (R) => [0, 1, 2].flatMap((k) => [R[0][k], R[1][k], R[2][k]]);

export class Renderer {
  constructor(canvas, facts) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
    if (!gl || !gl.getExtension("EXT_color_buffer_float")) throw new Error("webgl2");
    [this.gl, this.canvas, this.facts, this.count] = [gl, canvas, facts, facts.gaussians];
    gl.getExtension("OES_texture_float_linear");
    const wide = gl.getExtension("EXT_float_blend") ? gl.RGBA32F : gl.RGBA16F;
    this.programs = {
      diffuse: makeProgram(gl, WHOLE, DIFFUSE), bounce: makeProgram(gl, WHOLE, BOUNCE),
      shared: makeProgram(gl, WHOLE, SHARED),
      layer: makeProgram(gl, WHOLE, LAYER), splat: makeProgram(gl, SPLAT_VERTEX, SPLAT_FRAGMENT),
      display: makeProgram(gl, WHOLE, DISPLAY),
    };
    this.textures = Object.fromEntries(
      ["place", "shape", "matter", "seen", "starts", "hits", "adjoining", "placed", "lights", "order"].map((name) => [name, makeTexture(gl)]),
    );
    this.textures.sky = makeTexture(gl, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, 1, 1, 0, gl.RGBA, gl.FLOAT, new Float32Array(4));
    this.targets = {
      diffuse: new Target(gl, gl.RGBA32F), gathered: new Target(gl, gl.RGBA32F), bounce: new Target(gl, gl.RGBA32F), colors: new Target(gl, gl.RGBA32F),
      image: new Target(gl, wide),
    };
    this.rows = Math.ceil(this.count / WIDTH);
    this.setPlaced(new Uint32Array(this.count));
    this.#makeQuads();
  }

  /** Two triangles for each splat of a batch; the shader makes their corners of their numbers. */
  #makeQuads() {
    const { gl } = this;
    this.quads = gl.createVertexArray();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    const corners = Uint16Array.from({ length: 6 * BATCH }, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  /** Matter of all frames, and the texels around each. */
  setSurface({ matter, adjoining }) {
    uploadWords(this.gl, this.textures.matter, wide(matter), 4);
    uploadWords(this.gl, this.textures.adjoining, adjoining, 1);
  }

  /** Tables of the frame that is shown. */
  setFrame(frame) {
    const { gl, textures } = this;
    for (const name of ["place", "shape"]) uploadWords(gl, textures[name], wide(frame[name]), 4);
    for (const name of ["seen", "starts", "hits"]) uploadWords(gl, textures[name], frame[name], 1);
    this.frame = frame;
  }

  /** Bit k of a Gaussian's word says that it sees the lamp that is placed as number k. */
  setPlaced(words) {
    uploadWords(this.gl, this.textures.placed, words, 1);
  }

  /** Front-to-back order of the next pictures. */
  setOrder(order) {
    uploadWords(this.gl, this.textures.order, order, 1);
  }

  /** Radiance of a panorama that is seen behind the subject. */
  setSky({ width, height, radiance }) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.textures.sky);
    const texels = new Float32Array(4 * width * height);
    for (let i = 0; i < width * height; i++) texels.set(radiance.subarray(3 * i, 3 * i + 3), 4 * i);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.REPEAT);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.FLOAT, texels);
  }

  /** Diffuse light and its bounce; again when the frame or a lamp has changed. */
  light(lights) {
    const { gl, targets, programs } = this;
    const texels = new Float32Array(8 * Math.max(1, lights.length));
    lights.forEach(({ position, intensity, bit }, j) => texels.set([...position, bit, ...intensity, 0], 8 * j));
    gl.bindTexture(gl.TEXTURE_2D, this.textures.lights);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 2, texels.length / 8, 0, gl.RGBA, gl.FLOAT, texels);
    this.lights = lights.length;
    this.#whole(programs.diffuse, targets.diffuse);
    this.#whole(programs.bounce, targets.gathered, {
      t_diffuse: [6, targets.diffuse.texture], t_starts: [8, this.textures.starts], t_hits: [9, this.textures.hits],
      rays: this.facts.bounce_rays,
    });
    this.#whole(programs.shared, targets.bounce, {
      t_gathered: [6, targets.gathered.texture], t_adjoining: [8, this.textures.adjoining],
    });
  }

  /** The canvas shows a layer from a camera of the canvas's size. */
  draw(camera, { layer = 0, exposure = 1, backdrop = [0, 0, 0], sky = null, factor = this.facts.rendering.supersample }) {
    const { gl, targets, programs, canvas } = this;
    this.#whole(programs.layer, targets.colors, {
      t_diffuse: [6, targets.diffuse.texture], t_bounce: [7, targets.bounce.texture], center: centerOf(camera), i_layer: layer,
    });
    const taps = filterTaps(this.facts.rendering, factor);
    const large = enlarged(camera, factor, (taps.length - factor) / 2);
    targets.image.bind(large.width, large.height);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.DST_ALPHA, gl.ONE, gl.ZERO, gl.ONE_MINUS_SRC_ALPHA);
    setUniforms(gl, programs.splat, { t_colors: [10, targets.colors.texture], center: centerOf(camera) });
    this.#splat(programs.splat, large);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    setUniforms(gl, programs.display, {
      t_image: [11, targets.image.texture], t_sky: [12, this.textures.sky], taps: [...taps, ...Array(16 - taps.length).fill(0)],
      i_taps: taps.length, i_factor: factor, i_encoded: Number([2, 5].includes(layer)),
      i_sky: sky && layer === 0 ? 1 : 0, sky_turn: sky?.turn ?? 0, sky_gain: sky?.gain ?? 0, backdrop,
      exposure: layer === 1 ? 1 : exposure, ...pinhole(camera),
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Calls back once all that was asked for is drawn. */
  finished(done) {
    const { gl } = this;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const look = () => {
      if (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return setTimeout(look, 1);
      gl.deleteSync(fence);
      return done();
    };
    setTimeout(look, 0);
  }

  #whole(program, target, more = {}) {
    const { gl, textures } = this;
    target.bind(WIDTH, this.rows);
    setUniforms(gl, program, {
      ...this.#gaussians(), t_lights: [3, textures.lights], t_seen: [4, textures.seen],
      t_placed: [5, textures.placed], i_lights: this.lights, i_count: this.count, ...more,
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #splat(program, camera) {
    const { gl, facts } = this;
    setUniforms(gl, program, {
      ...this.#gaussians(), ...pinhole(camera), t: camera.t, near: NEAR_M, t_order: [9, this.textures.order], i_count: this.count,
      dilation: Math.max(1e-6, facts.rendering.dilation_px2), i_compensate: Number(facts.rendering.compensate_opacity),
    });
    gl.bindVertexArray(this.quads);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(this.count / BATCH));
    gl.bindVertexArray(null);
  }

  #gaussians() {
    const { textures, frame, facts } = this;
    return {
      t_place: [0, textures.place], t_shape: [1, textures.shape], t_matter: [2, textures.matter],
      low: frame.low, high: frame.high, log_scales: facts.log_scales,
    };
  }
}

/** A table of 16-bit columns as 32-bit words. */
function wide(table) {
  return new Uint32Array(table.buffer, table.byteOffset, table.length / 2);
}

/** Uniforms of a camera. */
function pinhole({ R, K, width, height }) {
  return { m_R: columns(R), focal: [K[0][0], K[1][1]], principal: [K[0][2], K[1][2]], size: [width, height] };
}

/** The camera of the samples: `factor` to a pixel and direction, with a margin for the filter. */
function enlarged({ R, t, K, width, height }, factor, margin) {
  const large = [[factor * K[0][0], 0, factor * K[0][2] + margin], [0, factor * K[1][1], factor * K[1][2] + margin], [0, 0, 1]];
  return { R, t, K: large, width: width * factor + 2 * margin, height: height * factor + 2 * margin };
}
