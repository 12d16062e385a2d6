"""A page of export_viewer in Chromium, and pictures as the screen shows them."""

from __future__ import annotations

import cv2
import numpy as np

from tests.support.viewer.relit_page import SETTLED, open_page

DESK, PHONE = (800, 560), (360, 740)
COARSE = 0.5
"""Pixels of the screen to one of the page and direction: a CPU draws them."""


def opened(browser, path, heard, size=DESK, **options):
    """The page at a path, opened in a window; what it asks for and complains of goes to `heard`."""
    width, height = size
    page = browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=COARSE, **options)
    page.on("request", lambda request: heard.append(request.url))
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))
    assert open_page(page, path) == "open"
    return page


def pixels(page):
    """The canvas as a screenshot shows it once drawing is done, without the measured time and the ring of the focus."""
    page.evaluate(SETTLED)
    shot = page.locator("#canvas").screenshot(
        style="#rate { display: none } :focus-visible { outline: none !important }"
    )
    return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(np.float64)


def changed(one, other):
    """Mean difference of two pictures, in levels of 255."""
    return float(np.abs(one - other).mean())
