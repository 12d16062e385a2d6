// Frames of the capture: a slider, and play.

const FRAME_MS = 140;

export class Timeline {
  constructor(scene, changed) {
    Object.assign(this, { scene, changed });
    this.slider = document.getElementById("frame");
    this.button = document.getElementById("play");
    this.name = document.getElementById("frame-name");
    this.slider.max = scene.facts.timeline - 1;
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value)));
    this.button.addEventListener("click", () => this.toggle());
    this.toggle = this.toggle.bind(this);
    document.getElementById("timeline").hidden = scene.facts.timeline < 2;
  }

  /** Shows a frame by its place. */
  async show(place) {
    const { label } = this.scene.facts.frames[place];
    this.slider.value = place;
    this.slider.setAttribute("aria-valuetext", label);
    this.name.textContent = label;
    await this.scene.showFrame(place);
    this.changed();
  }

  /** What is shown is no frame: nothing plays, and the slider stays where it goes on. */
  leave() {
    if (this.playing) this.toggle();
    this.name.textContent = "posed";
  }

  /** The frame that is shown, or was before a pose. */
  get place() {
    return Number(this.slider.value);
  }

  step(by) {
    const { number, facts: { timeline } } = this.scene;
    return this.show(number === null ? this.place : (this.place + by + timeline) % timeline);
  }

  toggle() {
    this.playing = !this.playing;
    this.button.textContent = this.playing ? "❚❚" : "▶";
    this.button.ariaLabel = this.playing ? "Stop" : "Play the frames";
    if (this.playing) this.#run();
  }

  async #run() {
    while (this.playing) {
      const rest = new Promise((resolve) => setTimeout(resolve, FRAME_MS));
      await this.step(1);
      await rest;
    }
  }
}
