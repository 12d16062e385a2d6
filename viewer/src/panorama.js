// Panoramas: read, made, and reduced to the directions whose shadows were traced (pipeline/lighting/environment.py).

const FAR_M = 1e5;
const WIDEST = 2048;
/** Rows of a map with a sun: it is so much brighter than the sky that its edge shows the texels. */
const SHARP = 384;

/** Direction of a place of the map, both coordinates in [0, 1]. */
function directionAt(u, v) {
  const across = Math.sin(Math.PI * v);
  return [across * Math.sin(2 * Math.PI * u), Math.cos(Math.PI * v), -across * Math.cos(2 * Math.PI * u)];
}

/** Panorama from a function of the direction to linear RGB. */
export function analytic(radianceOf, height = 128) {
  const width = 2 * height;
  const radiance = new Float32Array(3 * width * height);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      radiance.set(radianceOf(directionAt((x + 0.5) / width, (y + 0.5) / height)), 3 * (y * width + x));
    }
  }
  return { width, height, radiance };
}

const mix = (a, b, share) => a.map((x, k) => x + (b[k] - x) * share);
const smooth = (low, high, x) => {
  const t = Math.min(1, Math.max(0, (x - low) / (high - low)));
  return t * t * (3 - 2 * t);
};

/** The standard overcast sky of the CIE, three times as bright at the zenith as at the horizon, over grey ground. */
export function overcastSky() {
  return analytic(([, y]) => {
    const sky = mix([0.3, 0.31, 0.33], [0.9, 0.95, 1.05], Math.max(0, y));
    return mix([0.1, 0.095, 0.09], sky, smooth(-0.06, 0.06, y));
  });
}

/** A low sun, warm near the horizon on its side, and a blue sky on the other. */
export function eveningSky() {
  const sun = [0.8, 0.36, 0.48];
  return analytic(([x, y, z]) => {
    const toward = x * sun[0] + y * sun[1] + z * sun[2];
    const glow = Math.exp(-5 * Math.abs(y)) * (0.35 + 0.65 * smooth(-0.6, 1, toward));
    const sky = mix(mix([0.16, 0.24, 0.44], [0.07, 0.12, 0.3], Math.max(0, y)), [1.1, 0.52, 0.22], glow);
    const disc = 34 * smooth(0.965, 0.995, toward);
    const lit = sky.map((c, k) => c + disc * [1, 0.7, 0.42][k]);
    return mix([0.09, 0.065, 0.05], lit, smooth(-0.04, 0.04, y));
  }, SHARP);
}

/** Radiance of the directions that lamps stand for, `height` rows, of a map that is turned counter-clockwise. */
export function reduced({ width, height, radiance }, rows, turn = 0) {
  const cells = 2 * rows;
  const sums = new Float64Array(3 * rows * cells);
  const weights = new Float64Array(rows * cells);
  for (let y = 0; y < height; y++) {
    const weight = Math.cos(Math.PI * y / height) - Math.cos(Math.PI * (y + 1) / height);
    const row = Math.min(rows - 1, Math.floor(rows * (y + 0.5) / height));
    for (let x = 0; x < width; x++) {
      const around = ((x + 0.5) / width - turn / (2 * Math.PI)) % 1;
      const cell = row * cells + Math.floor(cells * (around < 0 ? around + 1 : around)) % cells;
      weights[cell] += weight;
      for (let k = 0; k < 3; k++) sums[3 * cell + k] += weight * radiance[3 * (y * width + x) + k];
    }
  }
  return sums.map((sum, i) => sum / Math.max(weights[Math.floor(i / 3)], 1e-12));
}

/** Distant lamps of a reduced map, the bits of whose shadows begin at `bit`. */
export function skyLamps(radiance, rows, bit, gain = 1) {
  const lamps = [];
  for (let row = 0; row < rows; row++) {
    const angle = Math.PI / rows * (Math.cos(Math.PI * row / rows) - Math.cos(Math.PI * (row + 1) / rows));
    for (let column = 0; column < 2 * rows; column++) {
      const cell = row * 2 * rows + column;
      const direction = directionAt((column + 0.5) / (2 * rows), (row + 0.5) / rows);
      const intensity = [0, 1, 2].map((k) => gain * angle * FAR_M ** 2 * radiance[3 * cell + k]);
      if (intensity.some((x) => x > 0)) {
        lamps.push({ position: direction.map((x) => FAR_M * x), intensity, bit: bit + cell });
      }
    }
  }
  return lamps;
}

/** Panorama in a file: Radiance .hdr, or a picture that a browser reads, taken as sRGB. */
export async function readPanorama(file) {
  const map = /\.hdr$/i.test(file.name) ? readHdr(new Uint8Array(await file.arrayBuffer())) : await readPicture(file);
  if (map.width !== 2 * map.height) {
    throw new Error(`expected a panorama twice as wide as high, found ${map.width} × ${map.height}`);
  }
  return map;
}

async function readPicture(file) {
  const picture = await createImageBitmap(file).catch(() => {
    throw new Error("expected a panorama as .hdr, .jpg or .png, found something else");
  });
  const scale = Math.min(1, WIDEST / picture.width);
  const [width, height] = [Math.round(scale * picture.width), Math.round(scale * picture.height)];
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  context.drawImage(picture, 0, 0, width, height);
  const pixels = context.getImageData(0, 0, width, height).data;
  const radiance = new Float32Array(3 * width * height);
  for (let i = 0; i < radiance.length; i++) {
    const c = pixels[4 * Math.floor(i / 3) + i % 3] / 255;
    radiance[i] = c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  }
  return { width, height, radiance };
}

/** Pixels of a Radiance picture (Ward 1991), run lengths or not. */
export function readHdr(bytes) {
  let at = 0;
  const line = () => {
    let text = "";
    while (at < bytes.length && bytes[at] !== 10) text += String.fromCharCode(bytes[at++]);
    at++;
    return text;
  };
  if (!line().startsWith("#?")) throw new Error("expected a Radiance .hdr, found something else");
  while (at < bytes.length && line() !== "");
  const [, rows, columns] = line().match(/^-Y (\d+) \+X (\d+)$/) ?? [];
  if (!rows) throw new Error("expected a Radiance .hdr of rows from the top, found another order");
  const [height, width] = [Number(rows), Number(columns)];
  const radiance = new Float32Array(3 * width * height);
  const row = new Uint8Array(4 * width);
  for (let y = 0; y < height; y++) {
    at = bytes[at] === 2 && bytes[at + 1] === 2 && bytes[at + 2] < 128 ? readRuns(bytes, at + 4, row, width) : readFlat(bytes, at, row, width);
    for (let x = 0; x < width; x++) {
      const scale = row[3 * width + x] ? 2 ** (row[3 * width + x] - 136) : 0;
      for (let k = 0; k < 3; k++) radiance[3 * (y * width + x) + k] = scale * row[k * width + x];
    }
  }
  if (at > bytes.length) throw new Error("expected all rows of the .hdr, found fewer");
  return { width, height, radiance };
}

function readRuns(bytes, start, row, width) {
  let at = start;
  for (let x = 0; x < 4 * width && at < bytes.length;) {
    const count = bytes[at++];
    if (count > 128) row.fill(bytes[at++], x, x += count - 128);
    else {
      row.set(bytes.subarray(at, at + count), x);
      at += count;
      x += count || 4 * width;
    }
  }
  return at;
}

function readFlat(bytes, at, row, width) {
  for (let i = 0; i < 4 * width; i++) row[(i & 3) * width + (i >> 2)] = bytes[at + i];
  return at + 4 * width;
}
