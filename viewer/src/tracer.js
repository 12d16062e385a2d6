// Traces which Gaussians see a placed lamp, against the posed mesh, as pipeline/lighting/visibility.py does.
import { OneAtATime } from "./worker.js";

/** Runs in the worker alone, so it may use nothing from outside. */
function work() {
  const LEAF = 4;
  const ORIGIN_OFFSET = 64 * 2 ** -23;
  const LIGHT_CLEARANCE = 16 * 2 ** -23;
  let faces, anchors, corners, order, boxes, links, points, normals;

  /** Boxes of faces, halved at the median of their middles along the longest side, depth first. */
  function build() {
    const count = faces.length / 3;
    order = Uint32Array.from({ length: count }, (_, f) => f);
    const middles = new Float64Array(3 * count);
    for (let f = 0; f < count; f++) {
      for (let k = 0; k < 3; k++) middles[3 * f + k] = corners[9 * f + k] + corners[9 * f + 3 + k] + corners[9 * f + 6 + k];
    }
    [boxes, links] = [[], []];
    split(0, count, middles);
  }

  function split(first, end, middles) {
    const node = links.length / 2;
    links.push(first, end);
    const box = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
    for (let i = first; i < end; i++) {
      for (let c = 0; c < 9; c++) {
        const x = corners[9 * order[i] + c];
        if (x < box[c % 3]) box[c % 3] = x;
        if (x > box[3 + (c % 3)]) box[3 + (c % 3)] = x;
      }
    }
    boxes.push(...box);
    if (end - first <= LEAF) return;
    const sides = [box[3] - box[0], box[4] - box[1], box[5] - box[2]];
    const axis = sides.indexOf(Math.max(...sides));
    order.subarray(first, end).sort((a, b) => middles[3 * a + axis] - middles[3 * b + axis]);
    const half = (first + end) >> 1;
    split(first, half, middles);
    links[2 * node] = -(links.length / 2);
    split(half, end, middles);
  }

  /** Corners of all faces, and each texel's point, a little above its face. */
  function pose(vertices) {
    corners = new Float64Array(3 * faces.length);
    for (let i = 0; i < faces.length; i++) corners.set(vertices.subarray(3 * faces[i], 3 * faces[i] + 3), 3 * i);
    build();
    const lift = ORIGIN_OFFSET * Math.max(...[0, 1, 2].map((k) => boxes[3 + k] - boxes[k])) / 2;
    const count = anchors.length / 4;
    [points, normals] = [new Float64Array(3 * count), new Float64Array(3 * count)];
    for (let i = 0; i < count; i++) {
      const at = 9 * (anchors[4 * i] + 65536 * anchors[4 * i + 1]);
      const [a, b] = [anchors[4 * i + 2] / 65535, anchors[4 * i + 3] / 65535];
      const u = [3, 4, 5].map((k) => corners[at + k] - corners[at + k - 3]);
      const v = [6, 7, 8].map((k) => corners[at + k] - corners[at + k - 6]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const length = Math.hypot(...n) || 1;
      for (let k = 0; k < 3; k++) {
        normals[3 * i + k] = n[k] / length;
        points[3 * i + k] = a * corners[at + k] + b * corners[at + 3 + k] + (1 - a - b) * corners[at + 6 + k] + lift * n[k] / length;
      }
    }
  }

  const stack = new Int32Array(128);

  /** Anything is between a point and the lamp: boxes by slabs, faces by Möller and Trumbore (1997), from both sides. */
  function hidden(px, py, pz, dx, dy, dz) {
    const [ix, iy, iz] = [1 / dx, 1 / dy, 1 / dz];
    let top = 0;
    stack[top++] = 0;
    while (top) {
      const node = stack[--top];
      const b = 6 * node;
      const [x0, x1] = [(boxes[b] - px) * ix, (boxes[b + 3] - px) * ix];
      const [y0, y1] = [(boxes[b + 1] - py) * iy, (boxes[b + 4] - py) * iy];
      const [z0, z1] = [(boxes[b + 2] - pz) * iz, (boxes[b + 5] - pz) * iz];
      const enter = Math.max(Math.min(x0, x1), Math.min(y0, y1), Math.min(z0, z1), 0);
      const leave = Math.min(Math.max(x0, x1), Math.max(y0, y1), Math.max(z0, z1), 1);
      if (enter > leave) continue;
      const first = links[2 * node];
      if (first < 0) {
        stack[top++] = -first;
        stack[top++] = node + 1;
        continue;
      }
      for (let i = first; i < links[2 * node + 1]; i++) if (crosses(9 * order[i], px, py, pz, dx, dy, dz)) return true;
    }
    return false;
  }

  function crosses(c, px, py, pz, dx, dy, dz) {
    const [ax, ay, az] = [corners[c], corners[c + 1], corners[c + 2]];
    const [ux, uy, uz] = [corners[c + 3] - ax, corners[c + 4] - ay, corners[c + 5] - az];
    const [vx, vy, vz] = [corners[c + 6] - ax, corners[c + 7] - ay, corners[c + 8] - az];
    const [qx, qy, qz] = [dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx];
    const det = ux * qx + uy * qy + uz * qz;
    if (det === 0) return false;
    const [sx, sy, sz] = [px - ax, py - ay, pz - az];
    const u = (sx * qx + sy * qy + sz * qz) / det;
    if (u < 0 || u > 1) return false;
    const [rx, ry, rz] = [sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux];
    const v = (dx * rx + dy * ry + dz * rz) / det;
    if (v < 0 || u + v > 1) return false;
    const t = (vx * rx + vy * ry + vz * rz) / det;
    return t > 0 && t < 1 - LIGHT_CLEARANCE;
  }

  /** One byte a texel: 1 where it sees the lamp. */
  function seen([x, y, z]) {
    const mask = new Uint8Array(points.length / 3);
    for (let i = 0; i < mask.length; i++) {
      const [px, py, pz] = [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
      const [dx, dy, dz] = [x - px, y - py, z - pz];
      const above = dx * normals[3 * i] + dy * normals[3 * i + 1] + dz * normals[3 * i + 2];
      if (above > 0 && !hidden(px, py, pz, dx, dy, dz)) mask[i] = 1;
    }
    return mask;
  }

  self.onmessage = ({ data }) => {
    if (data.faces) [faces, anchors] = [data.faces, data.anchors];
    if (data.vertices) pose(data.vertices);
    const mask = seen(data.position);
    self.postMessage(mask, [mask.buffer]);
  };
}

/** Shadows of the lamps that are placed in the page. */
export class Tracer {
  constructor(avatar) {
    this.avatar = avatar;
    this.worker = new OneAtATime(work);
  }

  /** Texels of a frame that see a place; null if the lamp asked from a newer place before its turn. */
  trace(lamp, frame, position) {
    const { faces, anchors } = this.avatar;
    return this.worker.ask(lamp, () => {
      const question = { position };
      if (!this.sent) Object.assign(question, { faces, anchors });
      if (this.sent !== frame) question.vertices = frame.vertices;
      this.sent = frame;
      return question;
    });
  }
}
