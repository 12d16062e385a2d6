// Opens the page: an avatar, its scene, and the controls; or a message.
import { Avatar } from "./avatar.js";
import { byId } from "./controls.js";
import { HeadControls } from "./head.js";
import { LampControls } from "./lamps.js";
import { followKeys, followPointers } from "./navigation.js";
import { Beside, panoramaControls, pictureControls, StageControls } from "./panel.js";
import { skyLamps } from "./panorama.js";
import { Scene } from "./scene.js";
import { Timeline } from "./timeline.js";
import { about, describe, shadows } from "./words.js";

const SHOWN_MS = 6000;
const TURNS = 60;
const message = byId("message");

/** A sentence in place of the viewer, or for a while above it. */
function say(text, forGood = false) {
  message.textContent = text;
  message.hidden = false;
  message.classList.toggle("passing", !forGood);
  if (!forGood) setTimeout(() => { message.hidden = true; }, SHOWN_MS);
}

/** A reason in place of the viewer. */
function close(reason) {
  document.body.dataset.state = "failed";
  byId("viewer").hidden = true;
  say(`The avatar could not be shown: ${reason}`, true);
}

/** What the browser lacks, if anything. */
function missing() {
  if (typeof DecompressionStream === "undefined") return "a newer browser: Chrome 103, Firefox 115, Safari 16.4 or later";
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return "WebGL2, which this browser does not have or has turned off; try another browser, or turn on hardware acceleration";
  return gl.getExtension("EXT_color_buffer_float") ? "" : "a graphics processor that draws into textures of floats";
}

/** Canvas as large as its place on the screen. */
function fillStage(scene) {
  const { canvas } = scene;
  new ResizeObserver(() => {
    const scale = Math.min(devicePixelRatio, 2);
    [canvas.width, canvas.height] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.max(1, Math.round(scale * x)));
    scene.move();
  }).observe(canvas);
}

/** A time of a picture, as time and as rate. */
const rate = (ms) => `${ms.toFixed(ms < 10 ? 1 : 0)} ms a picture, ${(1000 / ms).toFixed(ms > 100 ? 1 : 0)} per second`;

/** Turns once around the avatar, as fast as it goes, and says the median time of a picture. */
async function measure(scene) {
  byId("measure").disabled = true;
  byId("measured").textContent = "Turning …";
  scene.times = [];
  for (let k = 0; k < TURNS; k++) {
    scene.orbit.turn(2 * Math.PI / TURNS, 0);
    const drawn = new Promise((resolve) => { scene.afterwards = resolve; });
    scene.move();
    await drawn;
  }
  scene.afterwards = null;
  byId("measured").textContent = `Once around: ${rate(scene.milliseconds)}, ${scene.canvas.width} × ${scene.canvas.height} pixels`;
  byId("measured").scrollIntoView({ block: "nearest" });
  byId("measure").disabled = false;
}

async function open() {
  const lacking = missing();
  if (lacking) return say(`To show the avatar, this page needs ${lacking}.`, true);
  const avatar = new Avatar();
  await avatar.load();
  message.hidden = true;
  byId("viewer").hidden = false;
  const scene = new Scene(avatar, byId("canvas"));
  scene.canvas.addEventListener("webglcontextlost", () => close("the browser has taken the graphics processor away from this page; load it again"));
  byId("subject").textContent = avatar.facts.subject;
  const beside = new Beside(scene);
  const stage = new StageControls(scene);
  const timeline = new Timeline(scene, () => {
    stage.refresh();
    if (scene.beside) beside.refresh();
    head?.refresh();
  });
  const head = new HeadControls(scene, timeline);
  new LampControls(scene);
  panoramaControls(scene, say, stage);
  pictureControls(scene, beside.leave);
  followPointers(scene, beside.leave);
  followKeys(scene, beside.leave, timeline);
  byId("measure").addEventListener("click", () => measure(scene));
  about(scene);
  scene.onShown(() => {
    describe(scene);
    const ms = scene.milliseconds;
    byId("rate-count").textContent = `${avatar.count.toLocaleString("en")} Gaussians`;
    byId("rate-ms").textContent = ms ? rate(ms) : "";
    byId("shadows").textContent = shadows(scene);
  });
  fillStage(scene);
  await timeline.show(0);
  Object.assign(window, { scene, skyLamps });
}

open().then(
  () => { document.body.dataset.state = "open"; },
  (error) => close(error.message),
);
