// Poses between those that sliders stop at: what each adds to the pose at rest, added up.

const LEVELS = 65535;

/** The stops around a place on a slider, from 0 at its first, and their weights; not the middle, which adds nothing. */
export function stopsAround(places, at) {
  const below = Math.min(Math.floor(at), places.length - 2);
  return [[below, 1 - at + below], [below + 1, at - below]]
    .filter(([stop, weight]) => weight > 0 && stop !== (places.length - 1) / 2)
    .map(([stop, weight]) => ({ place: places[stop], weight, nearest: Math.round(at) === stop }));
}

/** Tables of a pose as those of a frame. Shadows, bounces and normals of a Gaussian are those of one of the poses. */
export function posed(rest, parts) {
  const means = added(rest, parts, "means");
  const vertices = added(rest, parts, "vertices");
  const [low, high] = boxAround(means, vertices);
  const sources = [rest, ...parts.filter(({ nearest }) => nearest).map(({ frame }) => frame)];
  const from = sourceOf(sources);
  return {
    ...rest, between: true, low, high, means, vertices, ...hitsFrom(sources, from), seen: wordsFrom(sources, from),
    place: placeTable(rest, parts, means, low, high), shape: shapeTable(rest, parts, sources, from),
  };
}

function added(rest, parts, name) {
  const sum = Float32Array.from(rest[name]);
  for (const { frame, weight } of parts) {
    for (let i = 0; i < sum.length; i++) sum[i] += weight * (frame[name][i] - rest[name][i]);
  }
  return sum;
}

function boxAround(...clouds) {
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (const cloud of clouds) {
    for (let i = 0; i < cloud.length; i++) {
      if (cloud[i] < low[i % 3]) low[i % 3] = cloud[i];
      if (cloud[i] > high[i % 3]) high[i % 3] = cloud[i];
    }
  }
  return [low, high];
}

/** Of each Gaussian, the pose that moves it farthest from rest: of sliders that are pushed, the one that is about it. */
function sourceOf([rest, ...others]) {
  const from = new Uint8Array(rest.means.length / 3);
  for (let i = 0; i < from.length; i++) {
    let farthest = -1;
    others.forEach(({ means }, k) => {
      const moved = Math.hypot(...[0, 1, 2].map((c) => means[3 * i + c] - rest.means[3 * i + c]));
      if (moved > farthest) [farthest, from[i]] = [moved, k + 1];
    });
  }
  return from;
}

/** Opacities and quaternions q and -q, which are the same turn, are added up as they are nearest to those at rest. */
function placeTable(rest, parts, means, low, high) {
  const table = new Uint16Array(rest.place.length);
  const scale = low.map((x, k) => LEVELS / Math.max(high[k] - x, 1e-9));
  const q = new Float64Array(4);
  const signed = (frame, at) => 2 * frame.place[at] / LEVELS - 1;
  for (let i = 0; i < means.length / 3; i++) {
    const at = 8 * i;
    for (let k = 0; k < 3; k++) table[at + k] = Math.round(scale[k] * (means[3 * i + k] - low[k]));
    let opacity = rest.place[at + 3];
    for (let k = 0; k < 4; k++) q[k] = signed(rest, at + 4 + k);
    for (const { frame, weight } of parts) {
      opacity += weight * (frame.place[at + 3] - rest.place[at + 3]);
      let along = 0;
      for (let k = 4; k < 8; k++) along += signed(rest, at + k) * signed(frame, at + k);
      for (let k = 0; k < 4; k++) q[k] += weight * (Math.sign(along || 1) * signed(frame, at + 4 + k) - signed(rest, at + 4 + k));
    }
    table[at + 3] = Math.round(Math.min(LEVELS, Math.max(0, opacity)));
    const length = Math.hypot(...q) || 1;
    for (let k = 0; k < 4; k++) table[at + 4 + k] = Math.round(LEVELS * (q[k] / length + 1) / 2);
  }
  return table;
}

/** Logarithms of scales added up; normals, in a Gaussian's own axes, as its source has them. */
function shapeTable(rest, parts, sources, from) {
  if (parts.every(({ frame }) => frame.shape === rest.shape)) return rest.shape;
  const table = new Uint16Array(rest.shape.length);
  for (let i = 0; i < from.length; i++) {
    const at = 8 * i;
    table.set(sources[from[i]].shape.subarray(at, at + 8), at);
    for (let k = 0; k < 3; k++) {
      let log = rest.shape[at + k];
      for (const { frame, weight } of parts) log += weight * (frame.shape[at + k] - rest.shape[at + k]);
      table[at + k] = Math.round(Math.min(LEVELS, Math.max(0, log)));
    }
  }
  return table;
}

function wordsFrom(sources, from) {
  return Uint32Array.from(sources[0].seen, (_, i) => sources[from[i % from.length]].seen[i]);
}

function hitsFrom(sources, from) {
  const starts = new Uint32Array(from.length + 1);
  from.forEach((k, i) => { starts[i + 1] = starts[i] + sources[k].starts[i + 1] - sources[k].starts[i]; });
  const hits = new Uint32Array(starts[from.length]);
  from.forEach((k, i) => { hits.set(sources[k].hits.subarray(sources[k].starts[i], sources[k].starts[i + 1]), starts[i]); });
  return { starts, hits };
}
