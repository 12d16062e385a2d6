// The avatar of the page: its facts, and the tables of its frames, decoded when they are first shown.
import { adjoiningFrom, readBlock, startsFrom, tableFrom, wordsFrom } from "./blocks.js";

const LEVELS = 65535;

/** An avatar as the page's elements hold it. */
export class Avatar {
  constructor() {
    this.facts = JSON.parse(document.getElementById("facts").textContent);
    this.count = this.facts.gaussians;
    this.frames = new Map();
  }

  /** What no frame changes: matter, texels and their neighbours, the mesh, and the shapes of the first frame. */
  async load() {
    const names = ["matter", "shape-0", "anchors", "adjoining", "faces"];
    const [matter, shape, anchors, adjoining, faces] = await Promise.all(names.map(readBlock));
    this.matter = tableFrom(matter, this.count);
    this.shape = tableFrom(shape, this.count);
    this.anchors = tableFrom(anchors, this.count, 4);
    this.adjoining = adjoiningFrom(wordsFrom(adjoining), this.count);
    this.faces = wordsFrom(faces);
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
      key: place,
      place: table,
      shape: bytes.shape ? tableFrom(bytes.shape, this.count) : this.shape,
      seen: wordsFrom(bytes.seen),
      starts: startsFrom(bytes.hit_counts),
      hits: wordsFrom(bytes.hits),
      means: pointsFrom(table, 8, facts),
      vertices: pointsFrom(tableFrom(bytes.vertices, this.facts.vertices, 3), 3, facts),
    };
  }
}

/** Points in the box of a frame, metres, x y z of each; they are the first of `columns` columns. */
function pointsFrom(table, columns, { low, high }) {
  const points = new Float32Array(3 * (table.length / columns));
  for (let i = 0; i < points.length; i++) {
    const k = i % 3;
    points[i] = low[k] + ((high[k] - low[k]) * table[columns * ((i - k) / 3) + k]) / LEVELS;
  }
  return points;
}
