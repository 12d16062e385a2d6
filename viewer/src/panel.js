// Controls beside the picture: lights of the stage, panorama, exposure, layers, and the captured picture.
import { element } from "./lamps.js";
import { readPanorama } from "./panorama.js";
import { LAYERS } from "./renderer.js";

const byId = (id) => document.getElementById(id);

/** Calls back with a control's number or text, and says it, of a slider beside its name and to screen readers as `words` put it. */
function watch(id, changed, words = String) {
  const control = byId(id);
  const number = control.type === "range";
  const shown = element("span", { className: "value", ariaHidden: "true" });
  if (number) control.before(shown);
  const said = () => {
    if (!number) return;
    const value = Number(control.value);
    control.setAttribute("aria-valuetext", words(value));
    shown.textContent = `${value > 0 ? "+" : value < 0 ? "−" : ""}${Math.abs(value)}`;
  };
  control.addEventListener("input", () => {
    said();
    changed(number ? Number(control.value) : control.type === "checkbox" ? control.checked : control.value);
  });
  said();
  return control;
}

const stops = (value) => `${value >= 0 ? "plus" : "minus"} ${Math.abs(value)} stops`;

/** Buttons with the stage's lights by name; pressed are those that shine. */
export class StageControls {
  constructor(scene) {
    const { stage } = scene.lights;
    this.scene = scene;
    this.mode = watch("stage-mode", (mode) => {
      stage.mode = mode;
      scene.relight();
      this.refresh();
    });
    watch("stage-gain", (gain) => { stage.gain = gain; scene.relight(); }, stops);
    this.buttons = scene.facts.lights.map(({ name }, j) => {
      const button = element("button", { type: "button", textContent: name, title: name });
      button.addEventListener("click", () => this.#toggle(j));
      return button;
    });
    byId("stage-lights").append(...this.buttons);
  }

  /** From the lights that shine now on, those are chosen that are pressed. */
  #toggle(j) {
    const { lights, frame } = this.scene;
    const { stage } = lights;
    if (stage.mode !== "chosen") stage.chosen = new Set(lights.lit(frame).map(([k]) => k));
    stage.mode = this.mode.value = "chosen";
    if (!stage.chosen.delete(j)) stage.chosen.add(j);
    this.scene.relight();
    this.refresh();
  }

  refresh() {
    if (!this.scene.frame) return;
    const lit = new Set(this.scene.lights.lit(this.scene.frame).map(([j]) => j));
    this.buttons.forEach((button, j) => { button.ariaPressed = String(lit.has(j)); });
  }
}

/** Panoramas: built in, opened, or dropped. */
export function panoramaControls(scene, complain, lit) {
  const { lights } = scene;
  const chooser = watch("sky", (name) => choose(name, name === lights.opened?.name ? lights.opened.map : null));
  const choose = (name, map) => {
    lights.setSky(name, map);
    lit(name);
    scene.relight();
  };
  watch("sky-turn", (degrees) => { lights.sky.turn = degrees * Math.PI / 180; scene.relight(); }, (x) => `${x} degrees`);
  watch("sky-gain", (gain) => { lights.sky.gain = gain; scene.relight(); }, stops);
  watch("sky-shown", (shown) => { lights.sky.shown = shown; scene.request(); });
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
  byId("sky-file").addEventListener("change", (event) => { if (event.target.files[0]) open(event.target.files[0]); });
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

/** Sliders of a head's expression and gaze, one away from the middle at a time. */
export class HeadControls {
  constructor(scene, timeline) {
    this.scene = scene;
    byId("head").hidden = scene.facts.sliders.length === 0;
    this.sliders = scene.facts.sliders.map(({ name, places }) => {
      const input = element("input", { type: "range", min: 0, max: places.length - 1, step: 1 });
      input.addEventListener("input", () => timeline.show(places[Number(input.value)]));
      const row = element("label", { className: "row", textContent: `${name} ` });
      row.append(input);
      byId("head-sliders").append(row);
      return { input, places };
    });
    this.refresh();
  }

  /** Shows where the picture is on each: in the middle, if it is of a frame or of another slider. */
  refresh() {
    const { place, facts } = this.scene;
    for (const { input, places } of this.sliders) {
      const at = places.indexOf(place);
      input.value = at < 0 ? (places.length - 1) / 2 : at;
      input.setAttribute("aria-valuetext", facts.frames[places[input.value]].label);
    }
  }
}

/** Exposure, layer, samples, and the way home. */
export function pictureControls(scene, left) {
  watch("exposure", (value) => { scene.exposure = value; scene.request(); }, stops);
  watch("layer", (value) => { scene.layer = Number(value); scene.request(); });
  watch("quality", (value) => { scene.quality = value; scene.request(); });
  byId("home").addEventListener("click", () => { left(); scene.orbit.reset(); scene.move(); });
}

/** The captured picture of one camera beside the avatar, which is seen from the same camera. */
export class Beside {
  constructor(scene) {
    this.scene = scene;
    this.chooser = watch("beside", (camera) => this.show(camera));
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
    const { frame, label } = scene.facts.frames[scene.place];
    const picture = scene.facts.captured.find((one) => one.camera === scene.beside && one.frame === frame);
    byId("captured").hidden = !scene.beside;
    byId("stage").classList.toggle("beside", Boolean(scene.beside));
    byId("photograph").hidden = !picture;
    byId("rendered-caption").textContent = scene.beside ? `this page${scene.lights.stage.mode === "captured" ? "" : ", in other light"}` : "";
    byId("captured-caption").textContent = picture
      ? `captured by ${picture.camera}${picture.held_out ? ", never trained on" : ""}`
      : `${scene.beside} has no picture of ${label}`;
    if (picture) {
      byId("photograph").src = `data:image/jpeg;base64,${picture.jpeg}`;
      byId("photograph").alt = `Captured picture of frame ${frame} by camera ${picture.camera}`;
    }
    scene.fixed = scene.beside ? (picture ?? scene.fixed) : null;
    scene.move();
  }
}

/** Sentences about what is computed here, and what is not. */
export function about({ facts }) {
  const directions = 2 * facts.sky_height ** 2;
  const sentences = [
    `${facts.gaussians.toLocaleString("en")} Gaussians: ${facts.built}. Light is computed in this page, for every Gaussian, from albedo, normal and roughness.`,
    facts.shadow
      ? `Shadows are traced: of the stage's lights and of ${directions} directions of a panorama when the page was written, of lamps that you place while you drag them.`
      : "The avatar was built without shadows: every light reaches every part that faces it.",
    `A panorama shines as ${directions} distant lamps, each with a shadow of its own.`,
    facts.bounce ? "One bounce of diffuse light between parts of the body is added." : "",
    ...facts.left_out,
    "Nothing was loaded from a network, and nothing leaves this page.",
  ];
  byId("about-text").append(...sentences.filter(Boolean).map((textContent) => element("p", { textContent })));
}

/** Where the shadows come from, of all that shines now. */
export function shadows({ facts, lights, frame }) {
  if (!facts.shadow || !frame) return facts.shadow ? "" : "Without shadows";
  const count = lights.lit(frame).length;
  const traced = lights.lamps.length;
  const kinds = [
    count ? `${count} stage ${count === 1 ? "light" : "lights"} baked` : "",
    traced ? `${traced} ${traced === 1 ? "lamp" : "lamps"} traced here` : "",
    lights.sky.map ? `${2 * facts.sky_height ** 2} directions of the sky baked` : "",
  ].filter(Boolean);
  return kinds.length ? `Shadows: ${kinds.join(", ")}` : "No light";
}

/** A sentence on the picture, for screen readers. */
export function describe({ facts, place, layer, lights, canvas, frame }) {
  const shining = frame ? lights.lit(frame).length : 0;
  const sky = lights.sky.map ? `, the panorama ${lights.sky.name}` : "";
  const lamps = lights.lamps.length;
  canvas.setAttribute("aria-label", `${facts.subject}, ${facts.frames[place].label}, ${LAYERS[layer]}, lit by ${shining} lights of the stage, ${lamps} placed ${lamps === 1 ? "lamp" : "lamps"}${sky}`);
}
