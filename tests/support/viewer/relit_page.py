"""A page of export_viewer in Chromium without a GPU, and its picture beside the pipeline's."""

from __future__ import annotations

import base64
import io
import os
import shutil

import numpy as np
from PIL import Image

from pipeline.avatar.relighting.film import Relighter
from pipeline.base.color import srgb_from_linear
from pipeline.capture.records import ImageRecord
from pipeline.geometry.cameras import Camera

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
QUIET = [
    "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
"""Nothing of the browser itself asks the network for anything."""

SETTLED = "() => new Promise(done => { const look = () => scene.settled ? done() : setTimeout(look, 5); look(); })"
"""Waits until the picture is of what was asked for; a page forbids what Playwright's own waiting would do."""

OPENS_MS = 120_000
"""Far longer than a page takes to open: for machines that do much else."""


def launch(playwright, *more: str):
    """The browser; root, as in containers, has no sandbox."""
    sandbox = ["--no-sandbox"] * (os.geteuid() == 0)
    return playwright.chromium.launch(executable_path=CHROMIUM, args=[*sandbox, *QUIET, *(more or SOFTWARE_GL)])


def open_page(page, path) -> str:
    """Visit a page; returns "open", or "failed" if it says so."""
    page.goto(f"file://{path}")
    page.wait_for_selector("body[data-state]", timeout=OPENS_MS)
    return page.locator("body").get_attribute("data-state")


def lamp(position, intensity, bit: int | None = None) -> dict:
    """A light as the page takes it; without a bit of visibility the page traces its shadow."""
    placed = {"position": [float(x) for x in position], "intensity": [float(x) for x in intensity]}
    return placed if bit is None else placed | {"bit": bit}


def page_picture(
    page, place: int | None, camera: Camera | ImageRecord, lights: list[dict], exposure: float
) -> np.ndarray:
    """sRGB in [0, 1] that the page shows over black, of a frame by its place, or of what it shows."""
    seen = {"R": camera.R.tolist(), "t": camera.t.tolist(), "K": camera.K.tolist()}
    seen |= {"width": camera.width, "height": camera.height}
    asked = {"place": place, "camera": seen, "lights": lights, "options": {"exposure": exposure}}
    content = page.evaluate("asked => scene.still(asked)", asked).partition(",")[2]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(content))).convert("RGB")) / 255.0


def pipeline_picture(relighter: Relighter, frame, camera: Camera, brightest: float = 0.7):
    """The same of the pipeline; the exposure that brings bright parts to `brightest`, and the mask of the subject."""
    rgb, alpha = (tensor.numpy() for tensor in relighter.view(frame, camera))
    exposure = brightest / max(float(np.percentile(rgb[alpha > 0.5], 95)), 1e-6)
    return np.clip(srgb_from_linear(exposure * rgb), 0, 1), exposure, alpha > 0.5


def psnr_db(one: np.ndarray, other: np.ndarray, mask: np.ndarray) -> float:
    """Of the pixels of the subject."""
    return float(-10 * np.log10(np.square(one[mask] - other[mask]).mean()))
