import { Avatar } from "./avatar.js";
import { Renderer } from "./renderer.js";
import { Sorter } from "./sorter.js";
import { Tracer } from "./tracer.js";
import { skyLamps } from "./panorama.js";
(async () => {
  const avatar = new Avatar(); await avatar.load();
  const canvas = document.querySelector("canvas");
  const renderer = new Renderer(canvas, avatar.facts); renderer.setMatter(avatar.matter);
  const sorter = new Sorter(); const tracer = new Tracer(avatar);
  window.relight = { async draw({ place, camera, lights, options = {} }) {
    const frame = await avatar.frame(place); renderer.setFrame(frame);
    renderer.setOrder(await sorter.sort(frame.means, camera.R[2]));
    const words = new Uint32Array(avatar.count);
    for (const l of lights) if (l.placed >= 0) { const t0 = performance.now(); const m = await tracer.trace(l.placed, frame, l.position); console.log("traced", performance.now()-t0); m.forEach((v, i) => { words[i] |= v << l.placed; }); l.bit = (1 << 20) + l.placed; }
    renderer.setPlaced(words);
    canvas.width = camera.width; canvas.height = camera.height;
    renderer.light(lights); renderer.draw(camera, options);
    return canvas.toDataURL();
  }, skyLamps, avatar };
  window.ready = true;
})();
