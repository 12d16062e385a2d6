// Sentences about the picture: what is computed, where shadows come from, and what screen readers say.
import { byId, element } from "./controls.js";
import { LAYERS } from "./renderer.js";

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
    facts.sliders.length
      ? "Ends and middles of the head's sliders were placed, with their shadows, when the page was written, where the head stands in the first frame. Between them, and of several sliders together, this page adds up what they change, with the shadows of the nearest."
      : "",
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
  const nearest = frame.between && (count || lights.sky.map) ? " at the nearest pose" : "";
  return kinds.length ? `Shadows: ${kinds.join(", ")}${nearest}` : "No light";
}

/** A sentence on the picture, for screen readers. */
export function describe({ facts, label, layer, lights, canvas, frame }) {
  const shining = frame ? lights.lit(frame).length : 0;
  const sky = lights.sky.map ? `, the panorama ${lights.sky.name}` : "";
  const lamps = lights.lamps.length;
  canvas.setAttribute("aria-label", `${facts.subject}, ${label}, ${LAYERS[layer]}, lit by ${shining} lights of the stage, ${lamps} placed ${lamps === 1 ? "lamp" : "lamps"}${sky}`);
}
