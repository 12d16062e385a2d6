"""The page is well-formed, complete and escaped."""

from __future__ import annotations

from html.parser import HTMLParser

from pipeline.base.verdicts import Verdict
from pipeline.figures.page import Section, write_page

VOID = {"meta", "img", "br"}
VERDICTS = [
    Verdict("camera", "cam00", "good", "0.05 px"),
    Verdict("light", "L1", "weak", "uncertain: 3 < 4 & <b>odd</b>"),
    Verdict("light", "L2", "failed", "is the LED dead?"),
]


class Reader(HTMLParser):
    """Checks that tags close in order; keeps links, pictures and text."""

    def __init__(self):
        super().__init__()
        self.open, self.links, self.text = [], [], ""

    def handle_starttag(self, tag, attrs):
        self.links += [value for key, value in attrs if key in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in ("html", "head", "body"):
            assert self.open[-1] == tag
        self.open.pop()

    def handle_data(self, data):
        self.text += data


def read(path):
    reader = Reader()
    reader.feed(path.read_text())
    assert not reader.open
    return reader


def test_page_lists_what_is_not_good_first_and_links_only_its_neighbours(tmp_path):
    sections = [Section("The stage", "rig.png", "Look."), Section("Charts", "", "The method is none.")]
    write_page(tmp_path / "index.html", "Calibration of sub<ject", VERDICTS, sections)
    page, source = read(tmp_path / "index.html"), (tmp_path / "index.html").read_text()
    assert set(page.links) == {"rig.png"}
    assert "Calibration of sub<ject" in page.text
    assert "uncertain: 3 < 4 & <b>odd</b>" in page.text and "<b>odd" not in source
    assert page.text.index("is the LED dead?") < page.text.index("uncertain: 3") < page.text.index("0.05 px")
    assert "The method is none." in page.text
    assert "prefers-color-scheme: dark" in source and "width=device-width" in source
    assert "http" not in source


def test_page_says_when_there_is_nothing_to_worry_about(tmp_path):
    write_page(tmp_path / "a.html", "s", VERDICTS[:1], [])
    write_page(tmp_path / "b.html", "s", [], [])
    assert "Everything is good." in read(tmp_path / "a.html").text
    assert "Nothing was judged." in read(tmp_path / "b.html").text
