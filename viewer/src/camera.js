// Cameras: pinholes as the pipeline has them (x right, y down, z forward; the first pixel's centre is 0.5), and an orbit.

const FOV_Y = 36;

/** The middle of what an orbit looks at stands so much above that of the picture: the timeline lies below. */
const RAISED = 0.03;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));

/** Centre of projection in the world. */
export function centerOf({ R, t }) {
  return [0, 1, 2].map((k) => -(R[0][k] * t[0] + R[1][k] * t[1] + R[2][k] * t[2]));
}

/** Camera at `eye` that looks at `target`, upright; `focal` in pixels. */
export function lookAt(eye, target, focal, width, height) {
  const forward = unit(target.map((x, k) => x - eye[k]));
  const up = Math.abs(forward[1]) > 0.9999 ? [0, 0, -1] : [0, 1, 0];
  const right = unit(cross(forward, up));
  const R = [right, cross(forward, right), forward];
  const t = R.map((row) => -dot(row, eye));
  return { R, t, K: [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], width, height };
}

/** The same camera for a picture of another size, the whole of it in view. */
export function fitted(camera, width, height) {
  const scale = Math.min(width / camera.width, height / camera.height);
  const K = camera.K.map((row) => row.map((x) => scale * x));
  K[0][2] += (width - scale * camera.width) / 2;
  K[1][2] += (height - scale * camera.height) / 2;
  K[2] = [0, 0, 1];
  return { ...camera, K, width, height };
}

/** Pixel of a point, and its depth. */
export function project({ R, t, K }, point) {
  const [x, y, z] = R.map((row, k) => dot(row, point) + t[k]);
  return [K[0][0] * x / z + K[0][2], K[1][1] * y / z + K[1][2], z];
}

/** Point at a pixel and depth. */
export function unproject({ R, t, K }, [x, y], z) {
  const p = [(x - K[0][2]) / K[0][0] * z - t[0], (y - K[1][2]) / K[1][1] * z - t[1], z - t[2]];
  return [0, 1, 2].map((k) => R[0][k] * p[0] + R[1][k] * p[1] + R[2][k] * p[2]);
}

/** A camera that circles a point. */
export class Orbit {
  constructor(low, high) {
    this.home = low.map((x, k) => (x + high[k]) / 2);
    this.radius = Math.hypot(...high.map((x, k) => x - low[k])) / 2;
    this.reset();
  }

  /** In front of the subject, all of it in view. */
  reset() {
    this.target = [...this.home];
    [this.around, this.above] = [0.35, 0.08];
    this.distance = 1.15 * this.radius / Math.sin(FOV_Y * Math.PI / 360);
  }

  turn(around, above) {
    this.around += around;
    this.above = Math.min(1.5, Math.max(-1.5, this.above + above));
  }

  zoom(factor) {
    this.distance = Math.min(20 * this.radius, Math.max(0.2 * this.radius, this.distance * factor));
  }

  /** Moves what is looked at along the picture, pixels. */
  pan(camera, dx, dy) {
    const scale = this.distance / camera.K[0][0];
    this.target = this.target.map((x, k) => x - scale * (dx * camera.R[0][k] + dy * camera.R[1][k]));
  }

  camera(width, height) {
    const flat = Math.cos(this.above);
    const away = [flat * Math.sin(this.around), Math.sin(this.above), flat * Math.cos(this.around)];
    const eye = this.target.map((x, k) => x + this.distance * away[k]);
    const focal = Math.min(height, 1.4 * width) / (2 * Math.tan(FOV_Y * Math.PI / 360));
    const camera = lookAt(eye, this.target, focal, width, height);
    camera.K[1][2] -= RAISED * height;
    return camera;
  }

  /** Goes on from where another camera stands. */
  from(camera) {
    const eye = centerOf(camera);
    const away = eye.map((x, k) => x - this.home[k]);
    this.target = [...this.home];
    this.distance = Math.hypot(...away);
    this.around = Math.atan2(away[0], away[2]);
    this.above = Math.asin(away[1] / this.distance);
  }
}
