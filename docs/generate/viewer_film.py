"""Film the page of export_viewer: a lamp goes to and fro, then a sky turns around.

    python -m docs.generate.viewer_film --results results/subjectA

Opens results/SUBJECT/viewer/index.html in Chromium, uses its controls, and takes a picture after each step. Writes
docs/pictures/SUBJECT_viewer.webp, animated. Needs Debian's chromium and the Python package playwright.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from pathlib import Path

import tyro
from PIL import Image
from playwright import sync_api

from pipeline.base.code_digest import ROOT
from pipeline.base.files import written_whole
from tests.support.viewer.relit_page import SETTLED, launch, open_page

WINDOW = {"width": 960, "height": 600}
SHOWN_WIDTH = 680
STEPS = 18
"""Pictures of each of the two parts."""

PICTURE_MS = 110
QUALITY, EFFORT = 75, 6
"""Of WebP: with less effort than the most, a third larger, and what has moved leaves traces."""

MOST_BYTES = 260_000
"""With the README's other picture less than 300 kB, which a test asks for."""

WITHOUT_TIME = "#rate-ms { display: none }"
"""Hides the time of a picture, which says how busy the machine was that filmed."""

LAMP_TO = """([around]) => {
  const { lights, orbit } = scene, [lamp] = lights.lamps, reach = 1.15 * orbit.radius;
  lamp.position = [Math.sin(around), 0.35, Math.cos(around)].map((x, k) => orbit.home[k] + reach * x);
  scene.relight();
}"""


def run(*, results: Path, out: Path = ROOT / "docs/pictures") -> None:
    """Write the film of one subject.

    Args:
        results: folder results/SUBJECT, with its viewer.
        out: folder for SUBJECT_viewer.webp.

    Raises:
        ValueError: if the film is too large for a README.
    """
    with sync_api.sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport=WINDOW)
        open_page(page, (results / "viewer/index.html").resolve())
        page.select_option("#quality", "exact")
        pictures = [screenshot(page) for _ in steps(page)]
        browser.close()
    path = out / f"{results.name}_viewer.webp"
    with written_whole(path) as temporary:
        first, *others = pictures
        options = {"duration": PICTURE_MS, "loop": 0, "quality": QUALITY, "method": EFFORT}
        first.save(temporary, "WEBP", save_all=True, append_images=others, **options)
        if (size := temporary.stat().st_size) > MOST_BYTES:
            raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, found {size}; take fewer steps")


def steps(page: sync_api.Page) -> Iterator[None]:
    """Use the page's controls; yields after each."""
    for _ in range(2):
        page.locator("#canvas").press("-")  # farther, below the title
    page.select_option("#stage-mode", "off")
    page.click("#add-lamp")
    for k in range(STEPS):
        page.evaluate(LAMP_TO, [1.5 * math.cos(2 * math.pi * k / STEPS)])
        yield
    page.locator(".lamp button").click()
    page.select_option("#sky", "evening")
    for k in range(STEPS):
        page.locator("#sky-turn").fill(str(round(360 * k / STEPS) - 180))
        yield


def screenshot(page: sync_api.Page) -> Image.Image:
    """The page once its picture is of what was asked for."""
    page.evaluate(SETTLED)
    shown = Image.open(io.BytesIO(page.screenshot(style=WITHOUT_TIME))).convert("RGB")
    return shown.resize((SHOWN_WIDTH, round(shown.height * SHOWN_WIDTH / shown.width)), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    tyro.cli(run)
