"""Pictures of the page in Chromium against the pipeline's, and messages where there can be none."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.avatar.relighting.driving_signal import from_record
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.capture.shards import read_frame_shards
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.camera_paths import orbit
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import FrameLights
from pipeline.viewer.shown_frame import SKY_HEIGHT
from tests.support.viewer.ball_avatar import BRIGHT, LAMPS, MIDDLE
from tests.support.viewer.relit_page import lamp, launch, open_page, page_picture, pipeline_picture, psnr_db
from tests.support.viewer.shown_page import opened

pytestmark = pytest.mark.usefixtures("quiet_pages")


LEAST_DB = 45.0
"""The page rounds to 8 bits, 59 dB, and its tables to 16; a shadow's edge that falls on another texel costs more."""

PLACED = {"position": (1.5, 4.0, 4.0), "intensity": (20.0, 24.0, 30.0)}


@pytest.fixture(scope="module")
def relighter(ball):
    return Relighter(load_avatar(ball / "avatar", ball / "atlas.safetensors"), TraceIrradiance())


def lit_by(kind, relighter, signal, page):
    """A frame under the stage's lights, placed lamps or a panorama, and the same lights for the page."""
    if kind == "panorama":
        rng = np.random.default_rng(2)
        sky = Environment(rng.random((SKY_HEIGHT, 2 * SKY_HEIGHT, 3)).astype(np.float32) ** 4)
        asked = [sky.radiance.ravel().tolist(), SKY_HEIGHT, len(LAMPS)]
        lights = page.evaluate("([radiance, rows, bit]) => skyLamps(radiance, rows, bit)", asked)
        return relighter.under_pixels(signal, sky, np.eye(3)), lights
    if kind == "placed":
        lights = [lamp(**PLACED), lamp((-4.0, 3.0, 2.0), (30.0, 10.0, 5.0))]
    else:
        lights = [lamp(position, BRIGHT, bit) for bit, position in enumerate(LAMPS.values())]
    arrays = (np.array([light[name] for light in lights]) for name in ("position", "intensity"))
    return relighter.under_lights(signal, FrameLights(*arrays)), lights


@pytest.mark.parametrize("kind", ["stage", "placed", "panorama"])
def test_pictures_are_those_of_the_pipeline(used_page, ball, relighter, kind):
    """Two frames from four sides, near and far: 24 pictures of three kinds of light."""
    page, frames = used_page, read_frame_shards([ball / "shards/frames"])
    scores = []
    for place, number in enumerate((10, 11)):
        frame, lights = lit_by(kind, relighter, from_record(frames[number]), page)
        for camera in orbit(MIDDLE, 7.0 - 3 * place, 1.5, 1.0, 40.0, 96, 128, 4):
            expected, exposure, subject = pipeline_picture(relighter, frame, camera)
            shown = page_picture(page, place, camera, lights, exposure)
            assert subject.mean() > 0.2
            scores.append(psnr_db(shown, expected, subject))
    assert min(scores) >= LEAST_DB, scores


def test_a_lamp_that_is_hidden_is_told_from_one_that_is_not(used_page):
    """Below the floor a lamp lights nothing of its upper side, which fills the picture."""
    camera = orbit(np.array([2.0, 0, 0]), 0.5, 3.0, 0.0, 20.0, 32, 32, 1)[0]
    above, below = (page_picture(used_page, 0, camera, [lamp((2.0, y, 0.5), BRIGHT)], 1.0) for y in (4.0, -4.0))
    assert above.mean() > 0.2
    assert below.max() == 0


def test_without_webgl_the_page_says_so(playwright, ball):
    browser = launch(playwright, "--disable-gpu", "--disable-software-rasterizer", "--disable-3d-apis")
    page = browser.new_page()
    open_page(page, ball / "index.html")
    assert page.locator("#viewer").is_hidden()
    assert "needs WebGL2" in page.locator("#message").inner_text()
    browser.close()


def test_without_javascript_the_page_says_so(browser, ball):
    page = browser.new_page(java_script_enabled=False)
    page.goto(f"file://{ball}/index.html")
    assert page.locator(".message:visible").all_inner_texts() == [
        "This page computes light with JavaScript, which is turned off. Turn it on and load the page again."
    ]
    page.close()


def test_lost_graphics_processor_is_said(browser, ball, heard):
    page = opened(browser, ball / "index.html", heard)
    page.evaluate("scene.renderer.gl.getExtension('WEBGL_lose_context').loseContext()")
    page.wait_for_selector("body[data-state=failed]")
    assert page.locator("#viewer").is_hidden()
    assert "load it again" in page.locator("#message").inner_text()
    page.close()


def test_damaged_page_says_so(browser, ball, heard):
    whole = (ball / "index.html").read_text("utf-8")
    start = whole.index('id="place-0">') + len('id="place-0">')
    (ball / "index_damaged.html").write_text(whole[:start] + "eJwD" + whole[start + 4 :], "utf-8")
    page = browser.new_page()
    assert open_page(page, ball / "index_damaged.html") == "failed"
    assert page.locator("#message").inner_text().startswith("The avatar could not be shown: ")
    page.close()
