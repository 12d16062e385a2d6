// Sliders of a head's expression and gaze, which add up.
import { byId, DEGREES, DEVIATIONS, element, said, spoken } from "./controls.js";
import { stopsAround } from "./posing.js";

const UNITS = { degrees: DEGREES, "standard deviations": DEVIATIONS };

/** Poses a head by sliders, and goes back to the frame of the timeline. */
export class HeadControls {
  constructor(scene, timeline) {
    Object.assign(this, { scene, timeline });
    byId("head").hidden = byId("to-head").hidden = scene.facts.sliders.length === 0;
    byId("head-back").addEventListener("click", () => timeline.step(0));
    this.sliders = scene.facts.sliders.map((slider) => this.#row(slider));
    this.refresh();
  }

  #row({ name, places, farthest, unit }) {
    const step = unit === "degrees" ? 1 : 0.1;
    const input = element("input", { type: "range", min: -farthest, max: farthest, step, value: 0 });
    const row = element("label", { className: "row wide", textContent: `${name} ` });
    row.append(input);
    byId("head-sliders").append(row);
    const say = said(input, UNITS[unit]);
    input.addEventListener("input", () => { say(); this.#pose(); });
    return { input, say, name, places, farthest, unit };
  }

  #pose() {
    const pushed = this.sliders.filter(({ input }) => Number(input.value) !== 0);
    const stops = pushed.flatMap(({ input, places, farthest }) =>
      stopsAround(places, (Number(input.value) / farthest + 1) * (places.length - 1) / 2));
    const words = pushed.map(({ input, name, unit }) => `${name.toLowerCase()} ${spoken(Number(input.value), UNITS[unit])}`);
    const [{ places }] = this.sliders;
    this.timeline.leave();
    const pose = { rest: places[(places.length - 1) / 2], stops, label: words.join(", ") || "at rest", lit: this.timeline.place };
    this.scene.showPose(pose).then(() => this.timeline.changed());
  }

  /** To the middle, where a frame of the timeline is shown. */
  refresh() {
    const captured = this.scene.number !== null;
    byId("head-back").disabled = captured;
    for (const { input, say } of this.sliders) {
      if (captured) input.value = 0;
      say();
    }
  }
}
