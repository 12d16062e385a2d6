// Asks a worker one thing at a time; while it is busy, only the newest question of a kind waits.

/** A worker that runs one function, which may use nothing from outside of itself. */
export class OneAtATime {
  constructor(work) {
    this.worker = new Worker(URL.createObjectURL(new Blob([`(${work})()`], { type: "text/javascript" })));
    this.worker.onmessage = ({ data }) => {
      const { resolve } = this.running;
      resolve(data);
      this.running = null;
      this.#next();
    };
    this.waiting = new Map();
    this.running = null;
  }

  /** Answer to a question, or null if a newer one of its kind came before its turn. `prepare` makes it when sent. */
  ask(kind, prepare) {
    return new Promise((resolve) => {
      this.waiting.get(kind)?.resolve(null);
      this.waiting.delete(kind);
      this.waiting.set(kind, { prepare, resolve });
      if (!this.running) this.#next();
    });
  }

  #next() {
    const [first] = this.waiting;
    if (!first) return;
    this.waiting.delete(first[0]);
    this.running = first[1];
    this.worker.postMessage(this.running.prepare());
  }
}
