// Moves the camera: mouse, fingers, wheel and keys.

const RADIANS_A_PIXEL = 0.006;
const STEP = 0.08;

/** Leaves a captured camera for the orbit, from where it stands. */
function freed(scene, left) {
  if (scene.fixed) {
    scene.orbit.from(scene.fixed);
    left();
  }
  return scene.orbit;
}

/** One pointer turns, two pinch and pan; Shift or the right button pans. */
export function followPointers(scene, left) {
  const { canvas } = scene;
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { size: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const orbit = freed(scene, left);
    const before = fingers.size === 2 ? spread() : finger;
    const [x, y] = [finger.x, finger.y];
    Object.assign(finger, { x: event.clientX, y: event.clientY });
    const scale = canvas.width / canvas.clientWidth;
    if (fingers.size === 2) {
      const after = spread();
      orbit.zoom(before.size / after.size);
      orbit.pan(scene.camera(), scale * (after.x - before.x), scale * (after.y - before.y));
    } else if (event.shiftKey || event.buttons & 2) {
      orbit.pan(scene.camera(), scale * (event.clientX - x), scale * (event.clientY - y));
    } else orbit.turn(-RADIANS_A_PIXEL * (event.clientX - x), RADIANS_A_PIXEL * (event.clientY - y));
    scene.move();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    freed(scene, left).zoom(Math.exp(0.001 * event.deltaY));
    scene.move();
  }, { passive: false });
}

/** Keys of the canvas, also while no control has the focus. */
export function followKeys(scene, left, timeline) {
  const pan = (dx, dy) => (orbit) => orbit.pan(scene.camera(), 0.05 * dx * scene.canvas.height, 0.05 * dy * scene.canvas.height);
  const turns = {
    ArrowLeft: (orbit) => orbit.turn(-STEP, 0), ArrowRight: (orbit) => orbit.turn(STEP, 0),
    ArrowUp: (orbit) => orbit.turn(0, STEP), ArrowDown: (orbit) => orbit.turn(0, -STEP),
    "+": (orbit) => orbit.zoom(0.92), "=": (orbit) => orbit.zoom(0.92), "-": (orbit) => orbit.zoom(1 / 0.92),
    0: (orbit) => orbit.reset(),
  };
  const pans = { ArrowLeft: pan(1, 0), ArrowRight: pan(-1, 0), ArrowUp: pan(0, 1), ArrowDown: pan(0, -1) };
  const others = { " ": timeline.toggle, ",": () => timeline.step(-1), ".": () => timeline.step(1) };
  document.addEventListener("keydown", (event) => {
    if (![scene.canvas, document.body].includes(event.target) || event.ctrlKey || event.metaKey || event.altKey) return;
    const moves = (event.shiftKey && pans[event.key]) || turns[event.key];
    if (!moves && !others[event.key]) return;
    event.preventDefault();
    if (!moves) return others[event.key]();
    moves(freed(scene, left));
    scene.move();
  });
}
