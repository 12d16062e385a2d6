"""The avatar of a ball over a floor as a page, and a browser that shows it.

Needs Debian's chromium and the Python package playwright; without them tests are skipped, and say so.
"""

from __future__ import annotations

import pytest

from pipeline.stages import export_viewer
from tests.support.viewer.ball_avatar import write_ball
from tests.support.viewer.relit_page import CHROMIUM, launch
from tests.support.viewer.shown_page import opened


@pytest.fixture(scope="session")
def ball(tmp_path_factory):
    """Folder of the avatar and of its page, index.html."""
    folder = tmp_path_factory.mktemp("ball")
    inputs = write_ball(folder)
    export_viewer.run(**inputs, out=folder / "index.html", subject="ball & floor")
    return folder


@pytest.fixture(scope="module")
def playwright():
    """Playwright, stopped after each file: until then it has an event loop of its own."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="the Python package playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install chromium")
    with sync_api.sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browser(playwright):
    """Chromium without a GPU."""
    started = launch(playwright)
    yield started
    started.close()


@pytest.fixture(scope="module")
def heard():
    """All that pages ask for, and all that they complain of."""
    return []


@pytest.fixture
def quiet_pages(heard, ball):
    """Afterwards: the pages have asked for nothing but themselves, and complained of nothing."""
    heard.clear()
    yield
    pages = (f"file://{ball}/index.html", f"file://{ball}/head.html")
    assert [said for said in heard if not said.startswith(("data:", "blob:", *pages))] == []


@pytest.fixture(scope="module")
def used_page(browser, ball, heard):
    """The page of a file's tests, as the one before left it: for pictures that no control has a part in."""
    return opened(browser, ball / "index.html", heard)


@pytest.fixture
def page(used_page, quiet_pages):
    """The same as it opens."""
    used_page.reload()
    used_page.wait_for_selector("body[data-state=open]")
    return used_page
