// Sorts Gaussians by depth, front to back, in a worker.
import { OneAtATime } from "./worker.js";

/** Runs in the worker alone, so it may use nothing from outside. */
function work() {
  const BUCKETS = 65536;
  const counts = new Uint32Array(BUCKETS + 1);
  let means = new Float32Array(0);

  /** Indices by depth along a direction; equal buckets stay in the order of their indices. */
  function sorted(x, y, z) {
    const count = means.length / 3;
    const depths = new Float32Array(count);
    let low = Infinity;
    let high = -Infinity;
    for (let i = 0; i < count; i++) {
      const depth = x * means[3 * i] + y * means[3 * i + 1] + z * means[3 * i + 2];
      depths[i] = depth;
      if (depth < low) low = depth;
      if (depth > high) high = depth;
    }
    const scale = (BUCKETS - 1) / Math.max(high - low, 1e-12);
    counts.fill(0);
    for (let i = 0; i < count; i++) counts[1 + (((depths[i] - low) * scale) | 0)]++;
    for (let k = 0; k < BUCKETS; k++) counts[k + 1] += counts[k];
    const order = new Uint32Array(count);
    for (let i = 0; i < count; i++) order[counts[((depths[i] - low) * scale) | 0]++] = i;
    return order;
  }

  self.onmessage = ({ data }) => {
    if (data.means) means = data.means;
    const order = sorted(...data.forward);
    self.postMessage(order, [order.buffer]);
  };
}

/** Orders of the frame that is shown. */
export class Sorter {
  constructor() {
    this.worker = new OneAtATime(work);
  }

  /** Indices of the Gaussians of a frame along a viewing direction; null if a newer view asked before its turn. */
  sort(means, forward) {
    return this.worker.ask("view", () => {
      const question = means === this.sent ? { forward } : { forward, means };
      this.sent = means;
      return question;
    });
  }
}
