// Placed lamps: a handle each in the picture, and a row each in the panel.
import { project, unproject } from "./camera.js";
import { element, EV, spoken } from "./controls.js";
import { MOST_LAMPS } from "./lights.js";

const NUDGE = 0.04;

/** A lamp outside of the picture is held at its edge, so many pixels from it. */
const EDGE = 24;

/** Keeps handles and rows in step with the scene's lamps. */
export class LampControls {
  constructor(scene) {
    this.scene = scene;
    this.handles = document.getElementById("handles");
    this.rows = document.getElementById("lamps");
    this.add = document.getElementById("add-lamp");
    this.add.addEventListener("click", () => this.#added(scene.lights.addLamp()));
    scene.onShown(() => this.#follow());
  }

  #added(lamp) {
    const name = `Lamp ${lamp.number + 1}`;
    lamp.handle = element("button", { type: "button", className: "handle", textContent: lamp.number + 1 });
    lamp.handle.setAttribute("aria-roledescription", "lamp to drag");
    lamp.row = element("div", { className: "lamp" });
    const color = element("input", { type: "color", value: lamp.color, ariaLabel: `${name}: colour` });
    const gain = element("input", { type: "range", min: -4, max: 4, step: 0.1, value: lamp.gain, ariaLabel: `${name}: brightness` });
    const remove = element("button", { type: "button", textContent: "✕", ariaLabel: `Remove ${name.toLowerCase()}` });
    lamp.row.append(element("span", { textContent: name }), color, gain, remove);
    color.addEventListener("input", () => this.#change(() => { lamp.color = color.value; }));
    const say = () => gain.setAttribute("aria-valuetext", spoken(Number(gain.value), EV));
    gain.addEventListener("input", () => this.#change(() => { lamp.gain = Number(gain.value); say(); }));
    say();
    remove.addEventListener("click", () => this.#removed(lamp));
    this.#drag(lamp);
    this.#keys(lamp);
    this.handles.append(lamp.handle);
    this.rows.append(lamp.row);
    this.#change(() => {});
    lamp.handle.focus({ preventScroll: true });
  }

  #removed(lamp) {
    const { lights } = this.scene;
    this.#change(() => { lights.lamps = lights.lamps.filter((other) => other !== lamp); });
    lamp.handle.remove();
    lamp.row.remove();
    this.add.focus({ preventScroll: true });
  }

  #change(apply) {
    apply();
    this.add.disabled = this.scene.lights.lamps.length >= MOST_LAMPS;
    this.scene.relight();
  }

  /** Dragged along the picture; with Shift, or while another finger rests on the picture, along the view. */
  #drag(lamp) {
    const { scene } = this;
    const { handle } = lamp;
    let last = null;
    let other = false;
    this.scene.canvas.addEventListener("pointerdown", () => { other = last !== null; });
    this.scene.canvas.addEventListener("pointerup", () => { other = false; });
    handle.addEventListener("pointerdown", (event) => {
      handle.setPointerCapture(event.pointerId);
      last = [event.clientX, event.clientY];
    });
    handle.addEventListener("pointermove", (event) => {
      if (!last) return;
      const scale = scene.canvas.width / scene.canvas.clientWidth;
      const [dx, dy] = [scale * (event.clientX - last[0]), scale * (event.clientY - last[1])];
      last = [event.clientX, event.clientY];
      this.#shift(lamp, event.shiftKey || other ? [0, 0, Math.exp(-0.004 * dy / scale)] : [dx, dy, 1]);
    });
    for (const name of ["pointerup", "pointercancel"]) handle.addEventListener(name, () => { last = null; });
  }

  #keys(lamp) {
    const step = () => NUDGE * this.scene.canvas.height;
    const moves = {
      ArrowLeft: () => [-step(), 0, 1], ArrowRight: () => [step(), 0, 1], ArrowUp: () => [0, -step(), 1],
      ArrowDown: () => [0, step(), 1], PageUp: () => [0, 0, 1.05], PageDown: () => [0, 0, 1 / 1.05],
    };
    lamp.handle.addEventListener("keydown", (event) => {
      if (event.key === "Delete") return this.#removed(lamp);
      if (!moves[event.key]) return;
      event.preventDefault();
      this.#shift(lamp, moves[event.key]());
    });
  }

  /** Moves a lamp by pixels at its depth, and its depth by a factor. */
  #shift(lamp, [dx, dy, deeper]) {
    const camera = this.scene.camera();
    const [x, y, z] = project(camera, lamp.position);
    if (z <= 0) return;
    this.#change(() => { lamp.position = unproject(camera, [x + dx, y + dy], Math.max(0.05, z * deeper)); });
  }

  #follow() {
    const { canvas, lights, orbit } = this.scene;
    const camera = this.scene.camera();
    const scale = canvas.clientWidth / canvas.width;
    const center = project(camera, orbit.home)[2];
    for (const lamp of lights.lamps) {
      const [x, y, z] = project(camera, lamp.position);
      lamp.handle.hidden = z <= 0;
      const [left, top] = [[x, canvas.clientWidth], [y, canvas.clientHeight]].map(([at, size]) => Math.min(size - EDGE, Math.max(EDGE, scale * at)));
      lamp.handle.style.left = `${left}px`;
      lamp.handle.style.top = `${top}px`;
      lamp.handle.classList.toggle("outside", left !== scale * x || top !== scale * y);
      lamp.handle.style.setProperty("--lamp", lamp.color);
      lamp.handle.classList.toggle("behind", z > center);
      const place = lamp.position.map((v, k) => (v - orbit.home[k]).toFixed(1));
      lamp.handle.setAttribute("aria-label", `Lamp ${lamp.number + 1}, ${place[0]} m along x, ${place[1]} m up, ${place[2]} m along z of the avatar's middle`);
    }
  }
}
