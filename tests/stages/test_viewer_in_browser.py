"""The page that relights an avatar, in Chromium without a GPU: its pictures against the pipeline's, and its controls.

Needs Debian's chromium and the Python package playwright; without them it is skipped, and says so.
"""

from __future__ import annotations

import base64
import itertools
import re

import cv2
import numpy as np
import pytest

from pipeline.avatar.relighting.driving_signal import from_record
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.capture.shards import read_frame_shards
from pipeline.config.export_viewer import ExportViewer
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.camera_paths import orbit
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import FrameLights
from pipeline.stages import export_viewer
from pipeline.viewer.shown_frame import SKY_HEIGHT
from tests.support.viewer.ball_avatar import BRIGHT, LAMPS, MIDDLE, write_ball
from tests.support.viewer.eyes_head import write_head
from tests.support.viewer.relit_page import (
    CHROMIUM,
    SETTLED,
    lamp,
    launch,
    open_page,
    page_picture,
    pipeline_picture,
    psnr_db,
)

sync_api = pytest.importorskip("playwright.sync_api", reason="the Python package playwright is not installed")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")

LEAST_DB = 45.0
"""The page rounds to 8 bits, 59 dB, and its tables to 16; a shadow's edge that falls on another texel costs more."""

DESK, PHONE = (800, 560), (360, 740)
COARSE = 0.5
"""Pixels of the screen to one of the page and direction: a CPU draws them."""

PLACED = {"position": (1.5, 4.0, 4.0), "intensity": (20.0, 24.0, 30.0)}


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ball")
    inputs = write_ball(folder)
    export_viewer.run(**inputs, out=folder / "index.html", subject="ball & floor")
    return folder


@pytest.fixture(scope="module")
def playwright():
    with sync_api.sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browser(playwright):
    started = launch(playwright)
    yield started
    started.close()


@pytest.fixture(scope="module")
def heard():
    """All that pages ask for, and all that they complain of."""
    return []


@pytest.fixture(autouse=True)
def quiet_pages(heard, ball):
    """Afterwards: the pages have asked for nothing but themselves, and complained of nothing."""
    heard.clear()
    yield
    pages = (f"file://{ball}/index.html", f"file://{ball}/head.html")
    assert [said for said in heard if not said.startswith(("data:", "blob:", *pages))] == []


def opened(browser, ball, heard, size, name="index.html", **options):
    width, height = size
    page = browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=COARSE, **options)
    page.on("request", lambda request: heard.append(request.url))
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))
    assert open_page(page, ball / name) == "open"
    return page


@pytest.fixture(scope="module")
def used_page(browser, ball, heard):
    """The page of all tests, as the one before left it: for pictures that no control has a part in."""
    return opened(browser, ball, heard, DESK)


@pytest.fixture
def page(used_page):
    """The same as it opens."""
    used_page.reload()
    used_page.wait_for_selector("body[data-state=open]")
    return used_page


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


def pixels(page):
    """The canvas as a screenshot shows it once drawing is done, without the measured time and the ring of the focus."""
    page.evaluate(SETTLED)
    shot = page.locator("#canvas").screenshot(
        style="#rate { display: none } :focus-visible { outline: none !important }"
    )
    return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(np.float64)


def changed(one, other):
    return float(np.abs(one - other).mean())


def test_every_control_changes_the_picture(page):
    pictures = [pixels(page)]
    steps = [
        lambda: page.select_option("#stage-mode", "off"),
        lambda: page.click("#add-lamp"),
        lambda: page.locator(".lamp input[type=color]").fill("#ff2000"),
        lambda: page.select_option("#sky", "evening"),
        lambda: page.locator("#sky-turn").fill("90"),
        lambda: page.locator("#sky-gain").fill("-1"),
        lambda: page.locator("#sky-shown").uncheck(),
        lambda: page.locator("#exposure").fill("1"),
        lambda: page.select_option("#layer", "2"),
        lambda: page.select_option("#layer", "5"),
        lambda: page.locator("#frame").fill("1"),
    ]
    for step in steps:
        step()
        pictures.append(pixels(page))
    moved = [changed(before, after) for before, after in itertools.pairwise(pictures)]
    assert min(moved) > 0.2, moved
    assert "ms a picture" in page.locator("#rate").inner_text()
    label = page.locator("#canvas").get_attribute("aria-label")
    assert label == "ball & floor, frame 11, shadow, lit by 0 lights of the stage, 1 placed lamp, the panorama evening"


def test_lights_of_the_stage_are_chosen_by_name(page):
    buttons = page.locator("#stage-lights button")
    assert buttons.all_inner_texts() == list(LAMPS)
    pressed = "buttons => buttons.map(button => button.ariaPressed)"
    assert buttons.evaluate_all(pressed) == ["true", "true", "false"]
    buttons.nth(0).click()
    assert buttons.evaluate_all(pressed) == ["false", "true", "false"]
    assert page.locator("#stage-mode").input_value() == "chosen"


def test_lamp_is_dragged_and_moved_by_keys(page):
    page.click("#add-lamp")
    handle = page.locator(".handle")
    pixels(page)
    box = handle.bounding_box()
    page.mouse.move(box["x"] + 10, box["y"] + 10)
    page.mouse.down()
    page.mouse.move(box["x"] + 10 - 60, box["y"] + 10 + 40, steps=4)
    page.mouse.up()
    pixels(page)
    after = handle.bounding_box()
    assert (after["x"] - box["x"], after["y"] - box["y"]) == pytest.approx((-60, 40), abs=2)
    page.keyboard.press("ArrowRight")
    pixels(page)
    assert handle.bounding_box()["x"] > after["x"] + 10
    page.keyboard.press("Delete")
    assert handle.count() == 0


def test_keys_turn_and_step(page):
    page.select_option("#quality", "exact")
    page.locator("#canvas").focus()
    start = pixels(page)
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    turned = pixels(page)
    assert changed(start, turned) > 0.5
    page.keyboard.press("0")
    assert changed(start, pixels(page)) < 0.1
    page.keyboard.press(".")
    pixels(page)
    assert page.locator("#frame-name").inner_text() == "frame 11"


def test_fingers_turn_and_pinch_on_a_phone_and_nothing_is_wider_than_it(browser, ball, heard):
    page = opened(browser, ball, heard, PHONE, has_touch=True, is_mobile=True)
    start = pixels(page)
    send = page.context.new_cdp_session(page).send

    def touch(*moments):
        for moment, places in enumerate([*moments, ()]):
            kind = "touchEnd" if not places else "touchMove" if moment else "touchStart"
            points = [{"x": x, "y": 200, "id": finger} for finger, x in enumerate(places)]
            send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch([100], [160], [240])
    turned = pixels(page)
    assert changed(start, turned) > 0.5
    before = page.evaluate("scene.orbit.distance")
    touch([150, 230], [130, 250], [110, 270])  # 80 pixels apart, then 160: twice as near
    assert page.evaluate("scene.orbit.distance") == pytest.approx(before / 2)
    assert changed(turned, pixels(page)) > 0.5
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
    for _ in range(8):
        page.click("#add-lamp")
    pixels(page)
    stage = page.locator("#stage").bounding_box()
    for handle in page.locator(".handle:visible").all():  # also of lamps that are beside the picture
        box = handle.bounding_box()
        assert 0 <= box["x"] <= PHONE[0] - box["width"] and 0 <= box["y"] <= stage["height"] - box["height"]


def test_captured_picture_stands_beside_the_avatar(page):
    page.select_option("#beside", "cam1")
    pixels(page)
    assert page.locator("#photograph").evaluate("image => image.naturalWidth") == 40
    assert page.locator("#captured-caption").inner_text() == "captured by cam1"
    page.click("#home")
    assert page.locator("#captured").is_hidden()


def drop(page, path):
    """Drop a file onto the page, as a hand would: over it first, which shows that it may fall."""
    content = base64.b64encode(path.read_bytes()).decode()
    carried = page.evaluate_handle("""([text, name]) => {
      const carried = new DataTransfer();
      carried.items.add(new File([Uint8Array.from(atob(text), c => c.charCodeAt(0))], name));
      return carried;
    }""", [content, path.name])  # fmt: skip
    page.dispatch_event("main", "dragenter", {"dataTransfer": carried})
    assert page.locator("#dropping").is_visible()
    page.dispatch_event("main", "drop", {"dataTransfer": carried})
    assert page.locator("#dropping").is_hidden()


def test_opened_and_dropped_panoramas_shine_and_other_files_are_refused(page, tmp_path):
    page.select_option("#stage-mode", "off")
    dark = pixels(page)
    radiance = np.full((16, 32, 3), 0.5, np.float32)
    cv2.imwrite(str(tmp_path / "grey.hdr"), radiance)
    page.set_input_files("#sky-file", tmp_path / "grey.hdr")
    page.wait_for_selector("#sky option[data-opened]", state="attached")
    page.locator("#sky-shown").uncheck()
    assert changed(dark, pixels(page)) > 1
    lit = pixels(page)
    cv2.imwrite(str(tmp_path / "red.png"), np.full((8, 16, 3), (20, 20, 255), np.uint8))
    drop(page, tmp_path / "red.png")
    page.wait_for_selector('#sky option[value="red.png"]', state="attached")
    assert changed(lit, pixels(page)) > 1
    cv2.imwrite(str(tmp_path / "square.png"), np.zeros((8, 8, 3), np.uint8))
    drop(page, tmp_path / "square.png")
    page.wait_for_selector("#message:not([hidden])")
    expected = "square.png: expected a panorama twice as wide as high, found 8 × 8"
    assert page.locator("#message").inner_text() == expected


def test_sliders_of_a_head_add_up_and_the_timeline_takes_them_back(browser, ball, heard):
    """Expression and gaze change the picture, and so does what was captured again."""
    settings = ExportViewer(timeline_frames=2, code_axes=1, slider_steps=3)
    export_viewer.run(**write_head(ball / "head"), out=ball / "head.html", subject="eyes", settings=settings)
    page = opened(browser, ball, heard, DESK, "head.html")
    page.select_option("#layer", "1")  # albedo: what moves, not how it is lit
    sliders, name, back = (page.locator(one) for one in ("#head-sliders input", "#frame-name", "#head-back"))
    rows = [" ".join(row.split()) for row in page.locator("#head-sliders label").all_inner_texts()]
    assert rows == ["Expression 1 0 σ", "Gaze left and right 0°", "Gaze up and down 0°"]
    assert back.is_disabled()
    pictures = [pixels(page)]
    for slider, value in enumerate(("1.3", "-24", "9")):
        sliders.nth(slider).fill(value)
        pictures.append(pixels(page))
    assert sliders.evaluate_all("all => all.map(one => one.value)") == ["1.3", "-24", "9"]
    assert sliders.nth(1).get_attribute("aria-valuetext") == "minus 24 degrees"
    said = "expression 1 plus 1.3 standard deviations, gaze left and right minus 24 degrees, gaze up and down plus 9"
    assert said in page.locator("#canvas").get_attribute("aria-label")
    assert name.inner_text() == "posed"
    page.locator("#frame").fill("1")
    pictures.append(pixels(page))
    assert name.inner_text() == "frame 2" and sliders.evaluate_all("all => all.map(one => one.value)") == ["0"] * 3
    moved = [changed(before, after) for before, after in itertools.pairwise(pictures)]
    assert min(moved) > 0.05, moved
    sliders.first.fill("2")
    pixels(page)
    back.click()
    assert changed(pictures[-1], pixels(page)) < 0.1 and name.inner_text() == "frame 2"
    page.close()


def test_body_has_no_sliders(page):
    assert page.locator("#head").is_hidden()


def test_tab_stops_once_at_the_lights_of_the_stage(page):
    """A stage may have hundreds: arrows go from one to the next, and the one that was left is come back to."""
    page.locator("#stage-gain").focus()
    focused = "() => document.activeElement.textContent"
    page.keyboard.press("Tab")
    assert page.evaluate(focused) == "key"
    page.keyboard.press("ArrowRight")
    assert page.evaluate(focused) == "rim <b>"
    page.keyboard.press("Tab")
    assert page.evaluate(focused) == "Add a lamp"
    page.keyboard.press("Shift+Tab")
    assert page.evaluate(focused) == "rim <b>"
    page.keyboard.press("End")
    page.keyboard.press("ArrowRight")
    assert page.evaluate(focused) == "key"


def test_links_lead_to_parts_of_the_panel_and_leave_the_picture_where_it_is(page):
    assert page.locator("nav a:visible").all_inner_texts() == ["Light", "Picture", "Help"]
    for name in ("Help", "Picture", "Light"):
        page.click(f"nav a:text('{name}')")
        assert page.locator(f"h2:text('{name}')").evaluate("title => title.getBoundingClientRect().top") < DESK[1]
        assert page.evaluate("document.documentElement.scrollTop") == 0


def test_stage_lights_yield_to_a_sky_and_come_back(page):
    mode, turn = page.locator("#stage-mode"), page.locator("#sky-turn")
    assert turn.is_disabled()
    page.select_option("#stage-mode", "all")
    page.select_option("#sky", "evening")
    assert mode.input_value() == "off" and turn.is_enabled()
    page.select_option("#sky", "none")
    assert mode.input_value() == "all" and turn.is_disabled()
    page.select_option("#stage-mode", "off")
    page.click("#add-lamp")
    for sky in ("overcast", "none"):
        page.select_option("#sky", sky)
    assert mode.input_value() == "off"  # as it was chosen: the lamp shines
    page.locator(".lamp button").click()
    for sky in ("overcast", "none"):
        page.select_option("#sky", sky)
    assert mode.input_value() == "captured"  # or nothing would


def test_measured_rate_is_said_with_its_size(page):
    page.click("#measure")
    measured = page.locator("#measured")
    page.wait_for_selector("#measure:enabled", timeout=60_000)
    width, height = page.evaluate("[scene.canvas.width, scene.canvas.height]")
    assert re.fullmatch(
        rf"Once around: \d+(\.\d)? ms a picture, [\d.]+ per second, {width} × {height} pixels", measured.inner_text()
    )


def test_controls_have_names(page):
    page.click("#add-lamp")
    nameless = page.evaluate("""() => [...document.querySelectorAll('button, input, select, canvas')].filter(element =>
      !(element.getAttribute('aria-label') || element.labels?.length || element.textContent.trim()))
      .map(element => element.outerHTML)""")
    assert nameless == []


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
    page = opened(browser, ball, heard, DESK)
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
