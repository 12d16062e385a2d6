// Shadow maps of placed lamps: what the page can do where no rays were traced.
import { lookAt } from "./camera.js";
import { setUniforms } from "./gl.js";

export const MOST_LAMPS = 8;
const SIDE = 1024;
const WIDEST = 75 * Math.PI / 180;

/** One depth texture a lamp, drawn anew when a lamp or the frame has moved. */
export class ShadowMaps {
  constructor(gl) {
    this.gl = gl;
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.DEPTH_COMPONENT24, SIDE, SIDE, MOST_LAMPS);
    for (const [name, value] of [
      [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, value);
    this.framebuffer = gl.createFramebuffer();
    this.matrices = new Float32Array(16 * MOST_LAMPS);
    this.drawn = [];
  }

  /** All maps are of another frame. */
  forget() {
    this.drawn = [];
  }

  /** Draws the map of a lamp at a position, unless it is there. `splat(program, camera, uniforms)` draws Gaussians. */
  update(map, position, { low, high }, program, splat) {
    const key = position.join();
    if (this.drawn[map] === key) return;
    this.drawn[map] = key;
    const { gl } = this;
    const middle = low.map((x, k) => (x + high[k]) / 2);
    const radius = Math.hypot(...high.map((x, k) => x - low[k])) / 2;
    const distance = Math.max(1e-3, Math.hypot(...position.map((x, k) => x - middle[k])));
    const half = distance > radius ? Math.min(WIDEST, Math.asin(radius / distance)) : WIDEST;
    const camera = lookAt(position, middle, SIDE / (2 * Math.tan(half)), SIDE, SIDE);
    const range = [Math.max(0.01, distance - radius), distance + radius];
    this.#matrix(map, camera, range, 0.004 * radius);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, this.texture, 0, map);
    gl.drawBuffers([gl.NONE]);
    gl.viewport(0, 0, SIDE, SIDE);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    setUniforms(gl, program, { range, center: position });
    splat(program, camera);
    gl.disable(gl.DEPTH_TEST);
  }

  /** World to the map: x, y times the depth, the depth's place in its range less a bias, and the depth. */
  #matrix(map, { R, t, K }, [near, far], bias) {
    const across = 2 * K[0][0] / SIDE;
    const deep = 2 / (far - near);
    const rows = [
      [...R[0].map((x) => across * x), across * t[0]],
      [...R[1].map((x) => across * x), across * t[1]],
      [...R[2].map((x) => deep * x), deep * (t[2] - near - bias) - 1],
      [...R[2], t[2]],
    ];
    for (let row = 0; row < 4; row++) {
      for (let column = 0; column < 4; column++) this.matrices[16 * map + 4 * column + row] = rows[row][column];
    }
  }
}
