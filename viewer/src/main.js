import { Avatar } from "./avatar.js";
import { Renderer } from "./renderer.js";
import { Sorter } from "./sorter.js";
import { skyLamps } from "./panorama.js";
(async () => {
  const avatar = new Avatar(); await avatar.load();
  const canvas = document.querySelector("canvas");
  const renderer = new Renderer(canvas, avatar.facts); renderer.setMatter(avatar.matter);
  const sorter = new Sorter();
  window.relight = { async draw({ place, camera, lights, options = {} }) {
    const frame = await avatar.frame(place); renderer.setFrame(frame);
    renderer.setOrder((await sorter.sort(frame.means, camera.R[2])).order);
    canvas.width = camera.width; canvas.height = camera.height;
    renderer.light(lights); renderer.draw(camera, options);
    return canvas.toDataURL();
  }, skyLamps, avatar };
  window.ready = true;
})();
