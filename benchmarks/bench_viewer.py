"""Milliseconds of the parts of a picture of the viewer, without a GPU, and how they grow.

    python -m benchmarks.bench_viewer --pages results/subjectA/viewer/index.html results/walker/viewer/index.html

opens each page in Chromium with software GL and times the sort, a placed lamp's shadow, the light of all Gaussians that
no camera changes, gloss and splats towards one camera, by the number of lights and the height of the picture. Each is
the median of some runs, waited for by reading a pixel back.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
from playwright import sync_api

from tests.support.viewer.relit_page import launch, open_page

LIGHTS = (1, 8, 24, 128)
HEIGHTS = (300, 600, 900)
REPEATS = 5

TIMED = """async ([lights, height, repeats]) => {
  const { renderer, canvas, sorter, tracer, orbit, facts } = scene, { gl } = renderer;
  const frame = await scene.avatar.frame(0);
  scene.frame = null;
  [canvas.width, canvas.height] = [Math.round(2 / 3 * height), height];
  const camera = orbit.camera(canvas.width, canvas.height);
  const done = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  const lamps = Array.from({ length: lights }, (_, j) => ({
    position: facts.lights[j % facts.lights.length].position, intensity: [1, 1, 1], bit: j % facts.lights.length }));
  const median = values => values.sort((a, b) => a - b)[values.length >> 1];
  const time = async work => {
    const taken = [];
    for (let k = 0; k <= repeats; k++) {
      const began = performance.now();
      await work(k);
      taken.push(performance.now() - began);
    }
    return median(taken.slice(1));
  };
  renderer.setFrame(frame);
  const place = k => frame.high.map((x, i) => x + (i === k % 3 ? 1 : 0.5) + 0.001 * k);
  const sort = await time(async () => { renderer.setOrder(await sorter.sort(frame.means, camera.R[2])); });
  const shadow = await time(k => tracer.trace(0, frame, place(k)));
  const light = await time(() => { renderer.light(lamps); gl.bindFramebuffer(gl.FRAMEBUFFER, null); done(); });
  const picture = await time(() => { renderer.draw(camera, {}); done(); });
  const fast = await time(() => { renderer.draw(camera, { factor: 1 }); done(); });
  return { gaussians: facts.gaussians, sort_ms: sort, shadow_of_a_lamp_ms: shadow, light_ms: light, picture_ms: picture,
           picture_of_one_sample_ms: fast };
}"""


def measured(pages: list[Path]) -> pd.DataFrame:
    """A row for each page and each number of lights at the middle height, and each height with 8 lights."""
    rows = []
    with sync_api.sync_playwright() as playwright:
        browser = launch(playwright)
        for path in pages:
            page = browser.new_page()
            open_page(page, path.resolve())
            for lights, height in dict.fromkeys([*((n, 600) for n in LIGHTS), *((8, h) for h in HEIGHTS)]):
                timed = page.evaluate(TIMED, [lights, height, REPEATS])
                rows.append({"page": path.parent.parent.name or path.stem, "lights": lights, "height": height, **timed})
            page.close()
        browser.close()
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pages", type=Path, nargs="+", required=True)
    print(measured(parser.parse_args().pages).round(1).to_string(index=False))


if __name__ == "__main__":
    main()
