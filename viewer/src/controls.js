// What all controls have: an element, its number beside its name, and that number in words for screen readers.

export const byId = (id) => document.getElementById(id);

/** A new element with some properties. */
export function element(name, properties = {}) {
  return Object.assign(document.createElement(name), properties);
}

/** A unit: as it is written behind a number, and as it is spoken. */
export const EV = { sign: "\u00a0EV", spoken: (x) => (x === 1 ? "stop" : "stops") };
export const DEGREES = { sign: "°", spoken: (x) => (x === 1 ? "degree" : "degrees") };
export const DEVIATIONS = { sign: "\u00a0σ", spoken: (x) => (x === 1 ? "standard deviation" : "standard deviations") };

/** A number with its sign and unit, to be read. */
export function written(value, { sign }) {
  return `${value > 0 ? "+" : value < 0 ? "−" : ""}${Math.abs(value)}${sign}`;
}

/** The same to be heard. */
export function spoken(value, unit) {
  const size = Math.abs(value);
  return `${value > 0 ? "plus " : value < 0 ? "minus " : ""}${size} ${unit.spoken(size)}`;
}

/** Calls back with a control's number, tick or text. A slider's number is said again by `watch.say` when it was set. */
export function watch(control, changed, unit = null) {
  const say = unit ? said(control, unit) : () => {};
  control.addEventListener("input", () => {
    say();
    changed(unit ? Number(control.value) : control.type === "checkbox" ? control.checked : control.value);
  });
  say();
  return control;
}

/** A slider's number beside its name, which a function writes anew. */
export function said(slider, unit) {
  const shown = element("span", { className: "value", ariaHidden: "true" });
  slider.before(shown);
  return () => {
    const value = Number(slider.value);
    slider.setAttribute("aria-valuetext", spoken(value, unit));
    shown.textContent = written(value, unit);
  };
}
