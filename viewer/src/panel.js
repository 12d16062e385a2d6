// Controls beside the picture: lights of the stage, panorama, exposure, layers, and the captured picture.
import { byId, DEGREES, element, EV, watch } from "./controls.js";
import { readPanorama } from "./panorama.js";

/** Buttons with the stage's lights by name; pressed are those that shine. */
export class StageControls {
  constructor(scene) {
    const { stage } = scene.lights;
    this.scene = scene;
    this.mode = watch(byId("stage-mode"), (mode) => this.#shine(mode));
    watch(byId("stage-gain"), (gain) => { stage.gain = gain; scene.relight(); }, EV);
    this.buttons = scene.facts.lights.map(({ name }, j) => {
      const button = element("button", { type: "button", textContent: name, title: name });
      button.addEventListener("click", () => this.#toggle(j));
      return button;
    });
    byId("stage-lights").append(...this.buttons);
    this.#rove();
  }

  #shine(mode) {
    this.before = null;
    this.scene.lights.stage.mode = this.mode.value = mode;
    this.scene.relight();
    this.refresh();
  }

  /** A sky is seen alone first, as these lights would hide it, unless they were chosen; without it they shine as before, or so that something does. */
  yieldTo(sky) {
    const { stage: { mode }, lamps } = this.scene.lights;
    if (sky && ["captured", "all"].includes(mode)) {
      this.#shine("off");
      this.before = mode;
    } else if (!sky && mode === "off" && (this.before || !lamps.length)) this.#shine(this.before ?? "captured");
  }

  /** One stop of Tab for all buttons, however many lights a stage has; arrow keys go on from there. */
  #rove() {
    const { buttons } = this;
    const reach = (k) => buttons.forEach((button, j) => { button.tabIndex = j === k ? 0 : -1; });
    buttons.forEach((button, k) => {
      button.addEventListener("focus", () => reach(k));
      button.addEventListener("keydown", (event) => {
        const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
        const next = { Home: 0, End: buttons.length - 1 }[event.key] ?? (by && (k + by + buttons.length) % buttons.length);
        if (next === undefined) return;
        event.preventDefault();
        buttons[next].focus();
      });
    });
    reach(0);
  }

  /** From the lights that shine now on, those are chosen that are pressed. */
  #toggle(j) {
    const { lights, frame } = this.scene;
    const { stage } = lights;
    if (stage.mode !== "chosen") stage.chosen = new Set(lights.lit(frame).map(([k]) => k));
    if (!stage.chosen.delete(j)) stage.chosen.add(j);
    this.#shine("chosen");
  }

  refresh() {
    if (!this.scene.frame) return;
    const lit = new Set(this.scene.lights.lit(this.scene.frame).map(([j]) => j));
    this.buttons.forEach((button, j) => { button.ariaPressed = String(lit.has(j)); });
  }
}

/** Panoramas: built in, opened, or dropped. */
export function panoramaControls(scene, complain, stage) {
  const { lights } = scene;
  const chooser = watch(byId("sky"), (name) => choose(name, name === lights.opened?.name ? lights.opened.map : null));
  const choose = (name, map) => {
    lights.setSky(name, map);
    if (lights.sky.map) scene.renderer.setSky(lights.sky.map);
    for (const id of ["sky-turn", "sky-gain", "sky-shown"]) byId(id).disabled = !lights.sky.map;
    stage.yieldTo(Boolean(lights.sky.map));
    scene.relight();
  };
  watch(byId("sky-turn"), (degrees) => { lights.sky.turn = degrees * Math.PI / 180; scene.relight(); }, DEGREES);
  watch(byId("sky-gain"), (gain) => { lights.sky.gain = gain; scene.relight(); }, EV);
  watch(byId("sky-shown"), (shown) => { lights.sky.shown = shown; scene.request(); });
  const open = async (file) => {
    try {
      const map = await readPanorama(file);
      lights.opened = { name: file.name, map };
      chooser.querySelector("[data-opened]")?.remove();
      const option = element("option", { value: file.name, textContent: file.name });
      option.dataset.opened = "";
      chooser.append(option);
      chooser.value = file.name;
      choose(file.name, map);
    } catch (error) {
      complain(`${file.name}: ${error.message}`);
    }
  };
  for (const id of ["sky-turn", "sky-gain", "sky-shown"]) byId(id).disabled = true;
  byId("sky-file").addEventListener("change", ({ target }) => {
    if (target.files[0]) open(target.files[0]);
    target.value = "";  // the same file again is a change, too
  });
  dropped(open);
}

function dropped(open) {
  const sign = byId("dropping");
  let depth = 0;
  const show = (by) => { depth = Math.max(0, depth + by); sign.hidden = depth === 0; };
  addEventListener("dragenter", (event) => { event.preventDefault(); show(1); });
  addEventListener("dragleave", () => show(-1));
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    depth = 0;
    show(0);
    if (event.dataTransfer.files[0]) open(event.dataTransfer.files[0]);
  });
}

/** Exposure, layer, samples, and the way home. */
export function pictureControls(scene, left) {
  watch(byId("exposure"), (value) => { scene.exposure = value; scene.request(); }, EV);
  watch(byId("layer"), (value) => { scene.layer = Number(value); scene.request(); });
  watch(byId("quality"), (value) => { scene.quality = value; scene.request(); });
  byId("home").addEventListener("click", () => { left(); scene.orbit.reset(); scene.move(); });
}

/** The captured picture of one camera beside the avatar, which is seen from the same camera. */
export class Beside {
  constructor(scene) {
    this.scene = scene;
    this.chooser = watch(byId("beside"), (camera) => this.show(camera));
    const cameras = [...new Set(scene.facts.captured.map(({ camera }) => camera))];
    this.chooser.append(...cameras.map((camera) => element("option", { value: camera, textContent: `captured by ${camera}` })));
    this.chooser.parentElement.hidden = cameras.length === 0;
    this.leave = () => { if (this.scene.beside) { this.chooser.value = ""; this.show(""); } };
  }

  show(camera) {
    this.scene.beside = camera;
    this.refresh();
    this.scene.move();
  }

  refresh() {
    const { scene } = this;
    const { number, label } = scene;
    const picture = scene.facts.captured.find((one) => one.camera === scene.beside && one.frame === number);
    byId("captured").hidden = !scene.beside;
    byId("stage").classList.toggle("beside", Boolean(scene.beside));
    byId("photograph").hidden = !picture;
    byId("rendered-caption").textContent = scene.beside ? `this page${scene.lights.stage.mode === "captured" ? "" : ", in other light"}` : "";
    byId("captured-caption").textContent = picture
      ? `captured by ${picture.camera}${picture.held_out ? ", never trained on" : ""}`
      : `${scene.beside} has no picture of ${number === null ? "a pose" : label}`;
    if (picture) {
      byId("photograph").src = `data:image/jpeg;base64,${picture.jpeg}`;
      byId("photograph").alt = `Captured picture of frame ${number} by camera ${picture.camera}`;
    }
    scene.fixed = scene.beside ? (picture ?? scene.fixed) : null;
    scene.move();
  }
}
