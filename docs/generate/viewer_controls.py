"""Use every control of a page of export_viewer, and keep a picture of the page after each.

    python -m docs.generate.viewer_controls --results results/subjectA --shots build/controls

Opens results/SUBJECT/viewer/index.html in Chromium. Writes a numbered .png a step into `shots`, and all of them on one
sheet, docs/pictures/SUBJECT_controls.webp. Prints how far the picture moved from the step before, levels of 255; fails
if a step that has to change it did not. Needs Debian's chromium and the Python package playwright.
"""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import tyro
from PIL import Image, ImageDraw
from playwright import sync_api

from docs.generate.control_steps import desk_steps, phone_steps
from docs.generate.page_gestures import Step
from pipeline.base.code_digest import ROOT
from pipeline.base.files import written_whole
from tests.support.viewer.relit_page import SETTLED, launch, open_page

DESK, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
THUMB = (320, 200)
COLUMNS, LABEL = 5, 18
"""Of the sheet; pixels of the line below a picture."""

QUALITY = 60
HEADER = 100
"""Rows of pixels with the measured time, which changes whatever is done."""

LEAST_CHANGE = 0.02
"""Mean of all pixels, levels of 255: a button that turns bright moves it by more."""


def run(*, results: Path, shots: Path, out: Path = ROOT / "docs/pictures") -> None:
    """Write the pictures of one subject's page.

    Args:
        results: folder results/SUBJECT, with its viewer.
        shots: folder for a picture of each step.
        out: folder for SUBJECT_controls.webp.

    Raises:
        ValueError: if a control did nothing.
    """
    path, taken = (results / "viewer/index.html").resolve(), []
    with sync_api.sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport=DESK)
        open_page(page, path)
        taken += pictures(page, desk_steps(page))
        page.close()
        phone = browser.new_page(viewport=PHONE, has_touch=True, is_mobile=True)
        open_page(phone, path)
        taken += pictures(phone, phone_steps())
        browser.close()
        blind = launch(playwright, "--disable-gpu", "--disable-software-rasterizer", "--disable-3d-apis")
        page = blind.new_page(viewport=DESK)
        open_page(page, path)
        taken.append(("without WebGL2, a message", Image.open(io.BytesIO(page.screenshot())).convert("RGB")))
        blind.close()
    for k, (name, picture) in enumerate(taken):
        with written_whole(shots / f"{k:02d} {name.replace('/', '_')}.png") as temporary:
            picture.save(temporary, "PNG")
    with written_whole(out / f"{results.name}_controls.webp") as temporary:
        sheet(taken).save(temporary, "WEBP", quality=QUALITY)


def pictures(page: sync_api.Page, steps: list[Step]) -> list[tuple[str, Image.Image]]:
    """The page after each step.

    Raises:
        ValueError: if a control did nothing.
    """
    taken, before = [], None
    for step in steps:
        step.act(page)
        page.evaluate(SETTLED)
        shown = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        now = np.asarray(shown, np.float32)[HEADER:]
        change = math.inf if before is None else float(np.abs(now - before).mean())
        print(f"{change:8.3f}  {step.name}", flush=True)
        if step.changes and change < LEAST_CHANGE:
            raise ValueError(f"{step.name}: expected another picture, found the same")
        taken.append((step.name, shown))
        before = now
    return taken


def sheet(taken: list[tuple[str, Image.Image]]) -> Image.Image:
    """All pictures on one, each over its name."""
    rows = -(-len(taken) // COLUMNS)
    width, height = THUMB[0], THUMB[1] + LABEL
    whole = Image.new("RGB", (COLUMNS * width, rows * height), "white")
    draw = ImageDraw.Draw(whole)
    for k, (name, picture) in enumerate(taken):
        x, y = width * (k % COLUMNS), height * (k // COLUMNS)
        small = picture.copy()
        small.thumbnail(THUMB, Image.Resampling.LANCZOS)
        whole.paste(small, (x + (width - small.width) // 2, y))
        draw.text((x + 4, y + THUMB[1] + 3), f"{k}. {name}", "black")
    return whole


if __name__ == "__main__":
    tyro.cli(run)
