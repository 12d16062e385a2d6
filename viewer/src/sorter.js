// Sorts Gaussians by depth, front to back, in a worker.

/** Runs in the worker alone, so it may use nothing from outside. */
function work() {
  const BUCKETS = 65536;
  let means = new Float32Array(0);
  const counts = new Uint32Array(BUCKETS + 1);

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
    for (let i = 0; i < count; i++) counts[1 + ((depths[i] - low) * scale | 0)]++;
    for (let k = 0; k < BUCKETS; k++) counts[k + 1] += counts[k];
    const order = new Uint32Array(count);
    for (let i = 0; i < count; i++) order[counts[(depths[i] - low) * scale | 0]++] = i;
    return order;
  }

  self.onmessage = ({ data }) => {
    if (data.means) means = data.means;
    const order = sorted(...data.forward);
    self.postMessage({ order, ticket: data.ticket }, [order.buffer]);
  };
}

/** Sorts one view at a time; while it is busy, only the newest of the views that ask waits. */
export class Sorter {
  constructor() {
    this.worker = new Worker(URL.createObjectURL(new Blob([`(${work})()`], { type: "text/javascript" })));
    this.worker.onmessage = ({ data }) => this.#done(data);
    this.waiting = null;
    this.running = null;
  }

  /** Order for a viewing direction; `means` are sent where they differ from those that the worker has. */
  sort(means, forward) {
    return new Promise((resolve) => {
      this.waiting?.resolve(null);
      this.waiting = { means, forward: [...forward], resolve };
      if (!this.running) this.#next();
    });
  }

  #next() {
    this.running = this.waiting;
    this.waiting = null;
    if (!this.running) return;
    const { means, forward } = this.running;
    this.worker.postMessage(means === this.sent ? { forward } : { forward, means });
    this.sent = means;
  }

  #done({ order }) {
    const { resolve, means } = this.running;
    resolve({ order, means });
    this.#next();
  }
}
