"""Light that is chosen in the page, in Chromium: the stage's, placed lamps and panoramas."""

from __future__ import annotations

import base64
import itertools

import cv2
import numpy as np
import pytest

from tests.support.viewer.ball_avatar import LAMPS
from tests.support.viewer.shown_page import changed, pixels


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
