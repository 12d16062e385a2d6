"""Gestures on the viewer's page: mouse, keys, fingers and files."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image
from playwright.sync_api import Page

SKY_ROWS = 64


@dataclass(frozen=True)
class Step:
    """Something that a person does.

    Attributes:
        name: said below the picture.
        act: does it.
        changes: whether the picture has to be another than before.
    """

    name: str
    act: Callable[[Page], object]
    changes: bool = True


def pick(name: str, control: str, value: str, changes: bool = True) -> Step:
    """Choose from a list."""
    return Step(name, lambda page: page.select_option(control, value), changes)


def slide(name: str, control: str, value: str) -> Step:
    """Move a slider."""
    return Step(name, lambda page: page.locator(control).fill(value))


def click(name: str, control: str, changes: bool = True) -> Step:
    """Press a button."""
    return Step(name, lambda page: page.locator(control).first.click(), changes)


def press(name: str, control: str, *keys: str) -> Step:
    """Press keys on a control."""
    return Step(name, lambda page: [page.locator(control).first.press(key) for key in keys])


def drag(name: str, control: str, by: tuple[int, int], key: str = "") -> Step:
    """Drag with the mouse, from the control's middle."""

    def act(page: Page) -> None:
        box = page.locator(control).first.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        if key:
            page.keyboard.down(key)
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + by[0], y + by[1], steps=6)
        page.mouse.up()
        if key:
            page.keyboard.up(key)

    return Step(name, act)


def wheel(page: Page) -> None:
    """Turn the mouse's wheel over the picture."""
    page.locator("#canvas").hover()
    page.mouse.wheel(0, -500)


def painted_sky(tint: tuple[float, float, float]) -> bytes:
    """A .png of a panorama: a light above a dark ground."""
    height = np.linspace(1, 0, SKY_ROWS)[:, None, None] ** 3
    rgb = np.broadcast_to(40 + 215 * height * np.array(tint), (SKY_ROWS, 2 * SKY_ROWS, 3))
    stored = io.BytesIO()
    Image.fromarray(rgb.astype(np.uint8)).save(stored, "PNG")
    return stored.getvalue()


def opened(page: Page) -> None:
    """Open a panorama by the button."""
    page.set_input_files(
        "#sky-file", {"name": "blue.png", "mimeType": "image/png", "buffer": painted_sky((0.3, 0.5, 1))}
    )
    page.wait_for_selector('#sky option[value="blue.png"]', state="attached")


def carried(page: Page, name: str, content: bytes) -> object:
    """What a hand carries that drags a file."""
    return page.evaluate_handle("""([text, name]) => {
      const carried = new DataTransfer();
      carried.items.add(new File([Uint8Array.from(atob(text), c => c.charCodeAt(0))], name));
      return carried;
    }""", [base64.b64encode(content).decode(), name])  # fmt: skip


def held(page: Page) -> None:
    """Hold a file over the page."""
    page.dispatch_event("main", "dragenter", {"dataTransfer": carried(page, "red.png", b"")})


def dropped(page: Page) -> None:
    """Drop a panorama."""
    page.dispatch_event("main", "drop", {"dataTransfer": carried(page, "red.png", painted_sky((1, 0.3, 0.2)))})
    page.wait_for_selector('#sky option[value="red.png"]', state="attached")


def refused(page: Page) -> None:
    """Drop what is no panorama."""
    page.dispatch_event("main", "drop", {"dataTransfer": carried(page, "notes.txt", b"no picture")})
    page.wait_for_selector("#message:not([hidden])")


def until(page: Page, expression: str) -> None:
    """Wait for a condition, as the page's policy forbids Playwright's own way."""
    page.evaluate(
        f"() => new Promise(done => {{ const look = () => {expression} ? done() : setTimeout(look, 5); look(); }})"
    )


def played(page: Page) -> None:
    """Play some frames, and stop."""
    before = page.locator("#frame-name").inner_text()
    page.click("#play")
    until(page, f"document.getElementById('frame-name').textContent !== '{before}'")
    page.click("#play")


def measured(page: Page) -> None:
    """Let the page turn once around and say how long a picture takes."""
    page.click("#measure")
    until(page, "!document.getElementById('measure').disabled")


def touched(page: Page, *moments: tuple[tuple[int, int], ...]) -> None:
    """Fingers at these places, one moment after the other; then they leave."""
    send = page.context.new_cdp_session(page).send
    for moment, places in enumerate([*moments, ()]):
        kind = "touchEnd" if not places else "touchMove" if moment else "touchStart"
        points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(places)]
        send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
