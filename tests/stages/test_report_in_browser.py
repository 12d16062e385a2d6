"""The report as a person meets it: in Chromium, wide and on a phone, light and dark, by pointer, finger and keys.

Needs Debian's chromium and the Python package playwright; without them it is skipped, and says so.
"""

from __future__ import annotations

import io
import os
import shutil

import numpy as np
import pytest
from PIL import Image

from pipeline.stages.write_report import run
from tests.support.results.reported_results import write_results

sync_api = pytest.importorskip("playwright.sync_api", reason="the Python package playwright is not installed")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")

PHONE, DESK = (360, 740), (1200, 900)
LEAST_CONTRAST = 4.5
"""Of text, WCAG 2.1 level AA."""

CONTRASTS = """() => {
  const parse = text => { const v = text.match(/[\\d.]+/g).map(Number); return v.length < 4 ? [...v, 1] : v; };
  const over = (top, under) => [0, 1, 2].map(k => top[k] * top[3] + under[k] * (1 - top[3]));
  const behind = element => {
    if (!element) return [255, 255, 255];
    const color = parse(getComputedStyle(element).backgroundColor);
    return color[3] === 1 ? color.slice(0, 3) : over(color, behind(element.parentElement));
  };
  const light = color => color.map(c => c / 255).map(c => c <= .04045 ? c / 12.92 : ((c + .055) / 1.055) ** 2.4)
    .reduce((sum, c, k) => sum + c * [.2126, .7152, .0722][k], 0);
  const rows = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement, text = walker.currentNode.data.trim();
    if (!text || !element.getClientRects().length || ['STYLE', 'SCRIPT'].includes(element.tagName)) continue;
    const back = behind(element), a = light(over(parse(getComputedStyle(element).color), back)), b = light(back);
    rows.push([text.slice(0, 40), (Math.max(a, b) + .05) / (Math.min(a, b) + .05)]);
  }
  return rows;
}"""


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        # Root, as in containers, has no sandbox.
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"] * (os.geteuid() == 0))
        yield started
        started.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    run(project_results=write_results(folder / "someone"), results=folder / "someone", out=folder / "index.html")
    return f"file://{folder}/index.html"


@pytest.fixture
def visit(browser, report):
    """A function: the opened page. Afterwards: it has asked for nothing but itself, and complained of nothing."""
    opened, requests, complaints = [], [], []

    def visit(size=DESK, scheme="light", **options):
        width, height = size
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme, **options)
        opened.append(context)
        page = context.new_page()
        page.on("request", lambda request: requests.append(request.url))
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(report)
        return page

    yield visit
    for context in opened:
        context.close()
    assert [url for url in requests if not url.startswith("data:image/")] == [report] * len(opened)
    assert not complaints


def shares(stack) -> tuple[float, float]:
    """Which shares of a slider's row of pixels are red, as what was captured, and green, as the rendering.

    The row lies below the middle, where the handle is, and above none of the labels.
    """
    row = np.asarray(Image.open(io.BytesIO(stack.screenshot())).convert("RGB")).astype(int)
    row = row[int(0.85 * len(row))]
    red, green = (row[:, k] > row[:, 1 - k] + 80 for k in (0, 1))
    return red.mean(), green.mean()


def point_at(page, stack, share: float) -> tuple[float, float]:
    stack.scroll_into_view_if_needed()
    box = stack.bounding_box()
    return box["x"] + share * box["width"], box["y"] + 0.4 * box["height"]


@pytest.mark.parametrize("size", [DESK, PHONE])
def test_edge_follows_the_pointer(visit, size):
    page = visit(size)
    stack = page.locator(".stack").nth(1)
    assert shares(stack) == pytest.approx((0.5, 0.5), abs=0.05)
    for start, end in ((0.5, 0.2), (0.2, 0.9), (0.6, 0.3)):  # The last one starts beside the edge.
        page.mouse.move(*point_at(page, stack, start))
        page.mouse.down()
        page.mouse.move(*point_at(page, stack, end), steps=5)
        page.mouse.up()
        page.mouse.move(0, 0)
        assert shares(stack) == pytest.approx((end, 1 - end), abs=0.05)
    assert shares(page.locator(".stack").nth(0)) == pytest.approx((0.5, 0.5), abs=0.05)


def test_edge_follows_a_finger(visit):
    page = visit(PHONE, has_touch=True, is_mobile=True)
    stack = page.locator(".stack").first
    page.touchscreen.tap(*point_at(page, stack, 0.25))
    assert shares(stack) == pytest.approx((0.25, 0.75), abs=0.05)


def test_edge_follows_the_keys(visit):
    page = visit()
    stack, control = page.locator(".stack").first, page.locator(".stack input").first
    page.locator(".choice input").first.focus()
    page.keyboard.press("Tab")
    assert control.evaluate("element => element === document.activeElement")
    assert stack.evaluate("element => getComputedStyle(element).outlineStyle") == "solid"
    for _ in range(20):
        page.keyboard.press("ArrowLeft")
    assert control.input_value() == "30"
    assert control.get_attribute("aria-valuetext") == "30 % captured, 70 % rendered"
    assert shares(stack) == pytest.approx((0.3, 0.7), abs=0.05)
    page.keyboard.press("Home")
    assert shares(stack) == pytest.approx((0, 1), abs=0.05)
    page.keyboard.press("End")
    assert shares(stack) == pytest.approx((1, 0), abs=0.05)


def test_keys_choose_what_is_compared(visit):
    page = visit()
    group = page.locator(".compared").first
    group.locator(".choice input").first.focus()
    page.keyboard.press("ArrowRight")
    stack = group.locator(".stack").last
    assert stack.get_attribute("data-right") == "error"
    # The error picture is pale yellow, neither red nor green.
    assert shares(stack) == pytest.approx((0.5, 0), abs=0.05)
    page.keyboard.press("ArrowRight")
    assert (stack.get_attribute("data-left"), stack.get_attribute("data-right")) == ("rendered", "error")
    assert stack.locator("input").get_attribute("aria-valuetext") == "50 % rendered, 50 % error"
    # Another avatar's pictures have their own choice.
    assert page.locator(".compared").nth(1).locator(".stack").first.get_attribute("data-left") == "captured"


def test_without_scripts_the_pictures_are_there(visit):
    page = visit(java_script_enabled=False)
    assert shares(page.locator(".stack").first) == pytest.approx((0.5, 0.5), abs=0.05)


@pytest.mark.parametrize("size", [PHONE, DESK])
def test_nothing_is_wider_than_the_screen_even_unfolded(visit, size):
    page = visit(size)
    for folded in (True, False):
        if not folded:
            page.evaluate("document.querySelectorAll('details').forEach(element => element.open = true)")
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read(visit, scheme):
    page = visit(scheme=scheme)
    page.evaluate("document.querySelectorAll('details').forEach(element => element.open = true)")
    back = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (max(map(int, back[4:-1].split(","))) < 60) == (scheme == "dark")
    rows = page.evaluate(CONTRASTS)
    assert len(rows) > 300
    assert not [row for row in rows if row[1] < LEAST_CONTRAST]


def test_plots_stand_on_white_in_the_dark(visit):
    page = visit(scheme="dark")
    plots = page.locator("#calibration img")
    assert {plots.nth(k).evaluate("element => getComputedStyle(element).backgroundColor") for k in range(3)} == {
        "rgb(255, 255, 255)"
    }


def test_links_lead_to_their_parts(visit):
    page = visit(PHONE)
    links = page.locator("nav a")
    assert links.count() == page.locator("section").count() == 16
    links.last.click()
    assert 0 <= page.locator("#provenance").bounding_box()["y"] < PHONE[1]
