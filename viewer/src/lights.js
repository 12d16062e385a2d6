// Lights of the page: those of the stage, lamps that are placed, and a panorama. All that shine add up.
import { eveningSky, overcastSky, reduced, skyLamps } from "./panorama.js";
import { PLACED } from "./renderer.js";

export const MOST_LAMPS = 8;
const COLORS = ["#fff1dc", "#cfe3ff", "#ffd0a8", "#d8ffd9", "#f3d0ff", "#ffffff", "#ffc4c4", "#c9fff6"];

/** Linear RGB of a colour as #rrggbb. */
export function linearColor(text) {
  return [1, 3, 5].map((k) => {
    const c = Number.parseInt(text.slice(k, k + 2), 16) / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  });
}

/** Everything that may shine, and whether it does. */
export class Lights {
  constructor(facts, middle, radius) {
    Object.assign(this, { facts, middle, radius });
    this.stage = { mode: "captured", gain: 0, chosen: new Set() };
    this.lamps = [];
    this.sky = { name: "none", gain: 0, turn: 0, shown: true, map: null };
    const sums = facts.frames.map(({ pattern }) => this.#irradiance(pattern.map(([j, ...rgb]) => [facts.lights[j].position, rgb])));
    /** What the brightest frame sends to the middle: lamps and skies are made as bright. */
    this.usual = Math.max(...sums) || 1;
  }

  #irradiance(lamps) {
    return lamps.reduce((sum, [position, rgb]) => sum + (rgb[0] + rgb[1] + rgb[2]) / 3 / this.#distance2(position), 0);
  }

  #distance2(position) {
    return position.reduce((sum, x, k) => sum + (x - this.middle[k]) ** 2, 0);
  }

  /** A lamp in front of the subject, beside those that are there. */
  addLamp() {
    const taken = new Set(this.lamps.map(({ number }) => number));
    const number = [...Array(MOST_LAMPS).keys()].find((k) => !taken.has(k));
    const angle = [0.9, -0.7, 2.5, -2.4, 0.1, 3.1, 1.7, -1.6][number];
    const away = 1.25 * this.radius;
    const position = [Math.sin(angle), 0.45, Math.cos(angle)].map((x, k) => this.middle[k] + away * x);
    const lamp = { number, position, color: COLORS[number], gain: 0, seen: null };
    this.lamps.push(lamp);
    return lamp;
  }

  /** Shows a panorama; `name` is one of those built in, or that of a file with its map. */
  setSky(name, map = null) {
    this.sky.name = name;
    this.sky.map = map ?? { evening: eveningSky, overcast: overcastSky }[name]?.() ?? null;
    this.sky.mean = this.sky.map ? Math.max(1e-6, reduced(this.sky.map, 1).reduce((sum, x) => sum + x) / 6) : 1;
  }

  /** Radiant intensity of a placed lamp. */
  intensity({ color, gain, position }) {
    const strength = 0.3 * this.usual * (1.6 * this.radius) ** 2 * 2 ** gain;
    return linearColor(color).map((c) => strength * c);
  }

  /** Gain of the panorama: as it is opened, its light is half as much as that of the brightest frame. */
  get skyGain() {
    return (0.5 * this.usual) / (4 * Math.PI * this.sky.mean) * 2 ** this.sky.gain;
  }

  /** Lights of the stage that shine in a frame, as index and intensity. */
  lit(frame) {
    const { mode, chosen, gain } = this.stage;
    const { lights } = this.facts;
    const own = { captured: () => frame.pattern.map(([j, ...rgb]) => [j, rgb]), off: () => [] }[mode];
    const rows = own ? own() : lights.map(({ intensity }, j) => [j, intensity]).filter(([j]) => mode === "all" || chosen.has(j));
    return rows.map(([j, rgb]) => [j, rgb.map((c) => c * 2 ** gain)]);
  }

  /** All that shines, as the renderer takes it. */
  list(frame) {
    const list = this.lit(frame).map(([j, intensity]) => ({ position: this.facts.lights[j].position, intensity, bit: j }));
    for (const lamp of this.lamps) {
      list.push({ position: lamp.position, intensity: this.intensity(lamp), bit: PLACED + lamp.number });
    }
    if (this.sky.map) {
      const rows = this.facts.sky_height;
      list.push(...skyLamps(reduced(this.sky.map, rows, this.sky.turn), rows, this.facts.lights.length, this.skyGain));
    }
    return list;
  }

  /** Words of visibility of the placed lamps; one whose rays are not back yet is seen by all. */
  placedWords(count) {
    const words = new Uint32Array(count);
    for (const { number, seen } of this.lamps) {
      for (let i = 0; i < count; i++) words[i] |= (seen ? seen[i] : 1) << number;
    }
    return words;
  }
}
