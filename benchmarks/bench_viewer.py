"""Milliseconds of the parts of a picture of the viewer, without a GPU, and how they grow.

    python -m benchmarks.bench_viewer --pages results/subjectA/viewer/index.html results/walker/viewer/index.html

opens each page in Chromium with software GL and times the sort, a placed lamp's shadow, the light of all Gaussians that
no camera changes, gloss and splats towards one camera, by the number of Gaussians, of lights, and the height of the
picture. Each is the shortest of some rounds through all of them, for others may use the machine for a while, waited for
by reading a pixel back.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
from playwright import sync_api

from tests.support.viewer.relit_page import launch, open_page

LIGHTS = (1, 8, 24, 128)
HEIGHTS = (300, 600, 900)
SHARES = (0.25, 0.5, 1.0)
"""Of the Gaussians: the first of the atlas, and as many splats, those in front."""

USUAL = {"share": 1.0, "lights": 8, "height": 600}
ROUNDS = 6

TIMED = """async ([share, lights, height]) => {
  const { renderer, canvas, sorter, tracer, orbit, facts } = scene, { gl } = renderer;
  const frame = await scene.avatar.frame(0);
  const count = Math.round(share * facts.gaussians);
  [renderer.count, renderer.rows] = [count, Math.ceil(count / 1024)];
  scene.frame = null;
  [canvas.width, canvas.height] = [Math.round(2 / 3 * height), height];
  const camera = orbit.camera(canvas.width, canvas.height);
  const done = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  const lamps = Array.from({ length: lights }, (_, j) => ({
    position: facts.lights[j % facts.lights.length].position, intensity: [1, 1, 1], bit: j % facts.lights.length }));
  const time = async work => {
    await work(0);
    const began = performance.now();
    await work(1);
    return performance.now() - began;
  };
  renderer.setFrame(frame);
  const place = k => frame.high.map((x, i) => x + (i === k % 3 ? 1 : 0.5) + 0.001 * k);
  const sort = await time(async () => {
    renderer.setOrder((await sorter.sort(frame.means, camera.R[2])).subarray(0, count));
  });
  const shadow = await time(k => tracer.trace(0, frame, place(k)));
  const light = await time(() => { renderer.light(lamps); gl.bindFramebuffer(gl.FRAMEBUFFER, null); done(); });
  const picture = await time(() => { renderer.draw(camera, {}); done(); });
  const fast = await time(() => { renderer.draw(camera, { factor: 1 }); done(); });
  return { gaussians: count, sort_ms: sort, shadow_of_a_lamp_ms: shadow, light_ms: light, picture_ms: picture,
           picture_of_one_sample_ms: fast };
}"""


def cases() -> list[tuple[float, int, int]]:
    """Share, lights and height of each row: one differs from what is usual."""
    changed = [("share", SHARES), ("lights", LIGHTS), ("height", HEIGHTS)]
    every = [tuple((USUAL | {name: value}).values()) for name, values in changed for value in values]
    return list(dict.fromkeys(every))


def measured(pages: list[Path]) -> pd.DataFrame:
    """A row for each page and number of Gaussians, of lights, and height, the others as usual."""
    rows, opened = [], {}
    with sync_api.sync_playwright() as playwright:
        browser = launch(playwright)
        for path in pages:
            opened[path.parent.parent.name or path.stem] = page = browser.new_page()
            open_page(page, path.resolve())
        for _ in range(ROUNDS):
            for name, page in opened.items():
                page.bring_to_front()
                for case in cases():
                    rows.append({"page": name, "lights": case[1], "height": case[2]} | page.evaluate(TIMED, [*case]))
        browser.close()
    return pd.DataFrame(rows).groupby(["page", "lights", "height", "gaussians"], sort=False).min().reset_index()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pages", type=Path, nargs="+", required=True)
    print(measured(parser.parse_args().pages).round(1).to_string(index=False))


if __name__ == "__main__":
    main()
