"""The panel of the page and its picture, in Chromium, used by mouse, keys, fingers and screen readers."""

from __future__ import annotations

import itertools
import re

import pytest

from pipeline.config.export_viewer import ExportViewer
from pipeline.stages import export_viewer
from tests.support.viewer.eyes_head import write_head
from tests.support.viewer.shown_page import DESK, PHONE, changed, opened, pixels

pytestmark = pytest.mark.usefixtures("quiet_pages")


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
    page = opened(browser, ball / "index.html", heard, PHONE, has_touch=True, is_mobile=True)
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


def test_sliders_of_a_head_add_up_and_the_timeline_takes_them_back(browser, ball, heard):
    """Expression and gaze change the picture, and so does what was captured again."""
    settings = ExportViewer(timeline_frames=2, code_axes=1, slider_steps=3)
    export_viewer.run(**write_head(ball / "head"), out=ball / "head.html", subject="eyes", settings=settings)
    page = opened(browser, ball / "head.html", heard)
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
