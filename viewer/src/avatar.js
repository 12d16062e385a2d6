// The avatar of the page: its facts, and the tables of its frames, decoded when they are first shown.
import { readBlock, startsFrom, tableFrom, wordsFrom } from "./blocks.js";

const LEVELS = 65535;

/** An avatar as the page's elements hold it. */
export class Avatar {
  constructor() {
    this.facts = JSON.parse(document.getElementById("facts").textContent);
    this.count = this.facts.gaussians;
    this.frames = new Map();
  }

  /** What no frame changes: matter, and the shapes of the first frame. */
  async load() {
    const [matter, shape] = await Promise.all([readBlock("matter"), readBlock("shape-0")]);
    this.matter = tableFrom(matter, this.count);
    this.shape = tableFrom(shape, this.count);
  }

  /** Tables of a frame by its place on the timeline. */
  frame(place) {
    if (!this.frames.has(place)) this.frames.set(place, this.#decode(place));
    return this.frames.get(place);
  }

  async #decode(place) {
    const facts = this.facts.frames[place];
    const names = facts.blocks.filter((name) => name !== "shape" || place > 0);
    const bytes = Object.fromEntries(
      await Promise.all(names.map(async (name) => [name, await readBlock(`${name}-${place}`)])),
    );
    const table = tableFrom(bytes.place, this.count);
    return {
      ...facts,
      place: table,
      shape: bytes.shape ? tableFrom(bytes.shape, this.count) : this.shape,
      seen: wordsFrom(bytes.seen),
      starts: startsFrom(bytes.hit_counts),
      hits: wordsFrom(bytes.hits),
      means: meansOf(table, this.count, facts),
    };
  }
}

/** Means of the Gaussians, metres, x y z of each. */
function meansOf(table, count, { low, high }) {
  const means = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < 3; k++) means[3 * i + k] = low[k] + ((high[k] - low[k]) * table[8 * i + k]) / LEVELS;
  }
  return means;
}
