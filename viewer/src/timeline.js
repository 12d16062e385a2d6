// Frames of the capture: a slider, and play.

const FRAME_MS = 140;

export class Timeline {
  constructor(scene, changed) {
    Object.assign(this, { scene, changed });
    this.slider = document.getElementById("frame");
    this.button = document.getElementById("play");
    this.name = document.getElementById("frame-name");
    this.slider.max = scene.facts.frames.length - 1;
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value)));
    this.button.addEventListener("click", () => this.toggle());
    this.toggle = this.toggle.bind(this);
    document.getElementById("timeline").hidden = scene.facts.frames.length < 2;
  }

  async show(place) {
    const { frame } = this.scene.facts.frames[place];
    this.slider.value = place;
    this.slider.setAttribute("aria-valuetext", `frame ${frame}`);
    this.name.textContent = `frame ${frame}`;
    await this.scene.showFrame(place);
    this.changed();
  }

  step(by) {
    const { length } = this.scene.facts.frames;
    return this.show((this.scene.place + by + length) % length);
  }

  toggle() {
    this.playing = !this.playing;
    this.button.textContent = this.playing ? "❚❚" : "▶";
    this.button.ariaPressed = String(this.playing);
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
