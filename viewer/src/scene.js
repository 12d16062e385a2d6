// What is shown, and the loop that draws it when something has changed.
import { fitted, Orbit } from "./camera.js";
import { Lights } from "./lights.js";
import { posed } from "./posing.js";
import { Renderer } from "./renderer.js";
import { Sorter } from "./sorter.js";
import { Tracer } from "./tracer.js";

const SLOW_MS = 40;
const REST_MS = 180;
const BACKDROP = [0.0066, 0.0075, 0.0091];
const REMEMBERED = 20;

/** The avatar, its lights, its camera and the canvas. */
export class Scene {
  constructor(avatar, canvas) {
    Object.assign(this, { avatar, canvas, facts: avatar.facts });
    const [first] = this.facts.frames;
    this.orbit = new Orbit(first.low, first.high);
    this.lights = new Lights(this.facts, this.orbit.home, this.orbit.radius);
    this.renderer = new Renderer(canvas, this.facts);
    this.renderer.setSurface(avatar);
    [this.sorter, this.tracer] = [new Sorter(), new Tracer(avatar)];
    Object.assign(this, { place: 0, layer: 0, exposure: 0, beside: "", quality: "auto", fixed: null, times: [], moved: 0 });
    this.shown = [];
  }

  /** Called after every picture. */
  onShown(listener) {
    this.shown.push(listener);
  }

  /** Shows a frame of the timeline. */
  showFrame(place) {
    const { frame, label } = this.facts.frames[place];
    return this.#show(place, { number: frame, label }, () => this.avatar.frame(place));
  }

  /**
   * Shows a pose of sliders, in the light of a frame: that at rest with what their stops add; at a stop of one of them,
   * what was placed there.
   */
  showPose({ rest, stops, label, lit }) {
    const [first = { place: rest, weight: 1 }] = stops;
    const stored = stops.length <= 1 && first.weight === 1;
    const key = `${lit}: ${stops.map(({ place, weight }) => `${place} ${weight}`)}`;
    const { pattern } = this.facts.frames[lit];
    const make = async () => {
      const [start, ...frames] = await Promise.all([rest, ...stops.map(({ place }) => place)].map((place) => this.avatar.frame(place)));
      if (this.place !== key) return null;
      const parts = stops.map((stop, k) => ({ ...stop, frame: frames[k] }));
      return { ...(stored ? frames[0] ?? start : posed(start, parts)), key, pattern };
    };
    return this.#show(key, { number: null, label }, make);
  }

  /** Shows what `make` gives, under a key, unless something else was asked for meanwhile. */
  async #show(key, { number, label }, make) {
    Object.assign(this, { place: key, number, label });
    const frame = await make();
    if (this.place !== key) return;
    const order = await this.sorter.sort(frame.means, this.camera().R[2]);
    if (this.place !== key || !order) return;
    this.frame = frame;
    this.renderer.setFrame(frame);
    this.renderer.setOrder(order);
    this.relight();
  }

  /** Traces the lamps anew, and lights the avatar at once and when the rays are back. */
  relight() {
    this.lit = false;
    for (const lamp of this.lights.lamps) this.#trace(lamp);
    this.request();
  }

  async #trace(lamp) {
    const { frame } = this;
    const at = lamp.position.join();
    if (!frame || (lamp.tracedFrame === frame && lamp.tracedAt === at)) return;
    [lamp.tracedFrame, lamp.tracedAt] = [frame, at];
    const seen = await this.tracer.trace(lamp, frame, lamp.position);
    if (!seen) return;
    lamp.seen = seen;
    this.lit = false;
    this.request();
  }

  /** The camera that the canvas shows. */
  camera() {
    const { width, height } = this.canvas;
    return this.fixed ? fitted(this.fixed, width, height) : this.orbit.camera(width, height);
  }

  /** Something has moved: sort anew, and draw. */
  async move() {
    this.moved = performance.now();
    this.request();
    const { frame } = this;
    if (!frame) return;
    const order = await this.sorter.sort(frame.means, this.camera().R[2]);
    if (!order || frame !== this.frame) return;
    this.renderer.setOrder(order);
    this.request();
  }

  /** Draws before the next frame of the display. */
  request() {
    if (this.drawing) this.again = true;
    else {
      this.asked ??= requestAnimationFrame(() => {
        this.asked = null;
        if (this.frame) this.draw();
      });
    }
  }

  /** Draws now. While the view moves and pictures take long, with one sample a pixel. */
  draw() {
    const { renderer, lights } = this;
    const began = performance.now();
    if (!this.lit) {
      renderer.setPlaced(lights.placedWords(this.avatar.count));
      renderer.light(lights.list(this.frame));
      this.lit = true;
    }
    const fast = this.quality === "fast" || (this.quality === "auto" && this.slow && performance.now() - this.moved < REST_MS);
    const { sky } = lights;
    renderer.draw(this.camera(), {
      layer: this.layer, exposure: 2 ** this.exposure, backdrop: this.fixed ? [0, 0, 0] : BACKDROP,
      sky: sky.map && sky.shown ? { turn: sky.turn, gain: lights.skyGain } : null, factor: fast ? 1 : undefined,
    });
    if (fast && this.quality === "auto") {
      clearTimeout(this.rest);
      this.rest = setTimeout(() => { this.rest = null; this.request(); }, REST_MS);
    }
    this.drawing = true;
    for (const listener of this.shown) listener(this);
    renderer.finished(() => this.#finished(began, fast));
  }

  /** The graphics processor is done; what was asked for meanwhile comes next, so that nothing lags behind. */
  #finished(began, fast) {
    const taken = performance.now() - began;
    this.times = [...this.times, taken].slice(-REMEMBERED);
    if (!fast) this.slow = taken > SLOW_MS;
    this.drawing = false;
    if (this.again) this.request();
    this.again = false;
    this.afterwards?.();
  }

  /** The picture is of what was asked for: nothing is drawn, sorted or traced any more, or waits for it. */
  get settled() {
    const shown = this.frame?.key === this.place;
    return shown && !(this.asked || this.drawing || this.rest || this.sorter.worker.running || this.tracer.worker.running);
  }

  /** Median time from the start of a picture until the graphics processor is done with it, of the last ones. */
  get milliseconds() {
    return [...this.times].sort((a, b) => a - b)[this.times.length >> 1] ?? 0;
  }

  /** Picture at another size of a frame, or of the pose that is shown, for a camera and lights, as the pipeline would make it. */
  async still({ place = null, camera, lights, options = {} }) {
    const frame = place === null ? this.frame : await this.avatar.frame(place);
    const { renderer, canvas, tracer } = this;
    const words = new Uint32Array(this.avatar.count);
    for (const [k, lamp] of lights.filter(({ bit }) => bit === undefined).entries()) {
      const seen = await tracer.trace(lamp, frame, lamp.position);
      seen.forEach((one, i) => { words[i] |= one << k; });
      lamp.bit = (1 << 20) + k;
    }
    const order = await this.sorter.sort(frame.means, camera.R[2]);
    [canvas.width, canvas.height] = [camera.width, camera.height];
    renderer.setFrame(frame);
    renderer.setOrder(order);
    renderer.setPlaced(words);
    renderer.light(lights);
    renderer.draw(camera, options);
    const picture = canvas.toDataURL();
    this.frame = null;
    return picture;
  }
}
