"""The report of planted results: everything is there, or named as missing; nothing is loaded; no one is given away."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import shutil
from html import unescape
from html.parser import HTMLParser

import pytest

from pipeline.base.errors import InputError
from pipeline.config.project import SubjectSettings
from pipeline.config.write_report import WriteReport, subject_changes
from pipeline.report.provenance import without_paths
from pipeline.stages.write_report import run
from tests.support.results.reported_results import OF_THE_PROJECT, OPTIONAL, plot, write_results

EFFECTS_TITLE = "Effects, planned against all on"
TITLES = (
    "Scores", "Captured and rendered", "In other light", "Ablations", "Effects", EFFECTS_TITLE, "Calibration",
    "Light patterns and sync", "Tracking", "Atlas", "Accuracy against time", "What each input costs", "Scaling of cost",
    "Hard cases", "Time and memory", "Provenance",
)  # fmt: skip


class Reader(HTMLParser):
    """Text by section, links and pictures; checks that tags close in order."""

    VOID = ("meta", "img", "br", "input")

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open, self.links, self.sections, self.images, self.section = [], [], {}, [], ""
        self.feed(source)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.links += [values[key] for key in ("src", "href", "data", "action", "srcset") if key in values]
        if tag == "section":
            self.section = values["id"]
            self.sections[self.section] = ""
        if tag == "img":
            assert values["alt"]
            self.images.append(self.section)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.section and not {"style", "script"} & set(self.open):
            self.sections[self.section] += data + " "


@pytest.fixture
def results(tmp_path):
    write_results(tmp_path / "someone")
    return tmp_path


def report(results, subject_settings: str = "{}", requests: tuple[str, ...] = (), **settings) -> str:
    out = results / "page/index.html"
    run(results=results / "someone", project_results=results, out=out,
        subject_settings=subject_settings, requests=requests, settings=WriteReport(**settings))  # fmt: skip
    return out.read_text()


def test_every_part_is_there_with_what_was_planted(results):
    page = Reader(report(results, requests=("track_mesh:1300:7", "train_avatar:2000:30")))
    parts = dict(zip(TITLES, page.sections.values(), strict=True))
    assert not [title for title, text in parts.items() if "Missing" in text]
    assert all(text.strip().startswith(title) for title, text in parts.items())
    assert "new cameras" in parts["Scores"] and "psnr: <planted>" in parts["Scores"]
    assert (
        "32 images" in parts["Scores"] and "none of: validation images, new segments, new patterns" in parts["Scores"]
    )
    assert "matte, against full" in parts["Ablations"] and "worse" in parts["Ablations"]
    assert re.search(r"all light PSNR \[dB\] \S+ ± \S+ −(0\.99|1\.00)", parts["Ablations"])
    assert all(text in parts["Effects"] for text in ("12.3", "12.34 % & more", "off", "9 s", "saved"))
    assert "camera <b> is uncertain" in parts["Calibration"]
    assert "16 frames, 6 of them fully lit" in parts["Light patterns and sync"]
    assert "in sync: as declared" in parts["Light patterns and sync"]
    assert "1.25 px" in parts["Tracking"] and "2.00 at worst" in parts["Tracking"]
    assert "16.00 ± 0.10" in parts["Accuracy against time"]
    assert re.search(r"our tracking 29\.00 28\.50", parts["What each input costs"])
    assert all(
        text in parts["Hard cases"] for text in ("2 cases, 1 pass, 1 do not", "a < b", "1e−09 (1e−06)", "not finite")
    )
    assert all(
        text in parts["Scaling of cost"]
        for text in (
            "0.98 [0.90, 1.10]",
            "more than predicted",
            "one <b> by one",
            "123 [100, 150]",
            "1 are as predicted",
        )
    )
    assert re.search(r"diffuse\s+everything[\s\S]*auto\s+39\.93\s+\+0\.07\s+10\.0\s+0\.25\s+6\s", parts[EFFECTS_TITLE])
    assert "loss is 0.07 dB" in parts[EFFECTS_TITLE]
    assert re.search(r"track_mesh\s+2\s+7\.0\s+5\.0\s+250\s+1300\s+7\s", parts["Time and memory"])
    shown = {anchor: page.images.count(anchor) for anchor in page.sections}
    assert shown["captured-and-rendered"] == 2 * 3 * 3
    assert (shown["calibration"], shown["tracking"], shown["in-other-light"], shown["atlas"]) == (3, 4, 1, 1)


def test_page_loads_nothing_and_gives_no_one_away(results):
    source = report(results)
    page = Reader(source)
    assert all(link.startswith(("data:image/", "#")) for link in page.links)
    assert "://" not in source and "@import" not in source and "url(" not in source
    assert "default-src 'none'" in unescape(source)
    text = re.sub(r"data:image/[^\"]*", "", source)
    assert str(results) not in text and not re.search(r"[\s>\"'](?:/\w+){2,}", text.replace("</", "<"))
    assert platform.node() not in " ".join(page.sections.values())


def test_what_is_not_there_is_named_with_its_command(results):
    for name in OPTIONAL:
        path = results / "someone" / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    for name in OF_THE_PROJECT:
        shutil.rmtree(results / name) if (results / name).is_dir() else (results / name).unlink()
    shutil.rmtree(results / "someone/images")
    shutil.rmtree(results / "someone/benchmarks")
    page = Reader(report(results))
    missing = {anchor for anchor, text in page.sections.items() if "Missing:" in text}
    assert missing == {
        "captured-and-rendered", "in-other-light", "calibration", "tracking", "accuracy-against-time",
        "what-each-input-costs", "hard-cases", "time-and-memory", "scaling-of-cost", "effects--planned-against-all-on",
    }  # fmt: skip
    assert "make results/someone/accuracy_cost.csv" in page.sections["accuracy-against-time"]
    assert "camera <b> is uncertain" in page.sections["calibration"]


def test_scaling_that_an_earlier_version_wrote_is_shown(results):
    (results / "scaling").rename(results / "growth")
    (results / "growth/scaling.png").rename(results / "growth/growth.png")
    text = Reader(report(results)).sections["scaling-of-cost"]
    assert "0.98 [0.90, 1.10]" in text and "Missing:" not in text


def test_one_avatar_has_no_ablation(tmp_path):
    write_results(tmp_path / "someone", {"full": 0.0})
    page = Reader(report(tmp_path))
    assert "only one avatar was trained" in page.sections["ablations"]


def test_same_results_give_the_same_page(results):
    assert report(results) == report(results)


@pytest.mark.parametrize("page_mb", [1, 2])
def test_page_is_as_small_as_was_asked_for(results, page_mb):
    for number in range(12):
        plot(results / f"someone/tracking/review/camera_{number:02d}.png", number)
    source = report(results, page_mb=page_mb, most_sheets=12)
    assert 0.2e6 * page_mb < len(source) < 1e6 * page_mb + 30_000  # The limit is on the parts; style comes on top.
    assert len(report(results, page_mb=100, most_sheets=12)) > 2.5e6


def test_provenance_tells_inputs_settings_and_code(results):
    settings = SubjectSettings(train_avatar={"steps": 77}, variants={"full": {}, "matte": {"specular": False}})
    changes = subject_changes(settings.model_copy(update={"chunk_frames": 12}))
    text = Reader(report(results, changes)).sections["provenance"]
    content = (results / "someone/index/cameras.parquet").read_bytes()
    assert hashlib.blake2b(content, digest_size=16).hexdigest() in text
    assert hashlib.blake2b(b"d0 m0\nd1 m1", digest_size=16).hexdigest() in text
    assert "ab" * 16 in text
    assert re.search(r"train_avatar\s+steps\s+77\s+\d+", text) and re.search(r"chunk_frames\s+12", text)
    assert re.search(r"write_report\s+[0-9a-f]{32}", text)
    assert re.search(r"numpy\s+\d+\.\d+", text) and re.search(r"memory\s+\d+\.\d GiB", text)


def test_provenance_of_a_public_set_is_said(results):
    path = results / "someone/index/capture.json"
    before = path.read_text()
    imported = {
        "dataset": "goliath", "given": {"cameras": "camera_calibration.json"}, "computed": {"masks": "pack_shards"},
        "left_out": {"keypoints": "nothing needs them"}, "assumed": {"light": "an even environment"},
    }  # fmt: skip
    path.write_text(json.dumps(json.loads(before) | {"imported": imported}))
    text = Reader(report(results)).sections["provenance"]
    path.write_text(before)
    assert "Imported from goliath" in text
    for row in ("cameras taken from camera_calibration", "masks computed by pack_shards", "keypoints not used nothing",
                "light assumed an even"):  # fmt: skip
        assert re.search(row.replace(" ", r"\s+"), text)


def test_absolute_paths_keep_their_last_name_only():
    assert without_paths("/home/ann/data/alexnet.pth") == "…/alexnet.pth"
    assert without_paths({"a": "~/x/y.csv", "b": 0.5, "c": "a/b.csv"}) == "{'a': '…/y.csv', 'b': 0.5, 'c': 'a/b.csv'}"
    assert without_paths("1/2 of ../b") == "1/2 of ../b"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "metrics.csv").unlink(), r"metrics\.csv: expected a csv table, found"),
        (lambda folder: (folder / "images/full_worst.png").write_text("x"), r"full_worst\.png: expected a PNG picture"),
        (lambda folder: (folder / "atlas.png").write_bytes(b"x" * 10**6), r"atlas\.png: expected a PNG picture"),
        (lambda folder: (folder / "effects.json").write_text("{"), r"effects\.json: expected a JSON file"),
    ],
)
def test_broken_files_are_named(results, change, message):
    change(results / "someone")
    with pytest.raises(InputError, match=message):
        report(results)


@pytest.mark.parametrize(("text", "message"), [("{", "expected JSON"), ("[1]", "expected {stage")])
def test_settings_that_are_none_are_refused(results, text, message):
    with pytest.raises(InputError, match=message):
        report(results, text)


def test_changed_settings_are_those_that_differ():
    assert subject_changes(SubjectSettings()) == "{}"
    assert json.loads(subject_changes(SubjectSettings(unwrap_atlas={"size": 64}))) == {"unwrap_atlas": {"size": 64}}


@pytest.mark.parametrize("word", ["track_mesh", "track_mesh:1:2:3", "track_mesh:much:7"])
def test_request_that_is_none_is_refused(results, word):
    with pytest.raises(InputError, match=f"--requests: expected STAGE:MEGABYTES:MINUTES, found {word}"):
        report(results, requests=(word,))
