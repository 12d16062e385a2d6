"""A tiny capture whose capture.yaml is broken one way at a time: each break must be named."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.captures.broken import Break, check_break, manifest, read_complaints

MANIFEST_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "unknown test pattern": (
        manifest(lambda m: m["splits"].update(test_patterns=[0, 9])),
        ["splits.test_patterns: expected one that the table of frames lists, found 9"],
    ),
    "unknown validation camera": (
        manifest(lambda m: m["splits"].update(validation_cameras=["nowhere"])),
        ["splits.validation_cameras: expected one that the table of cameras lists, found nowhere"],
    ),
    "missing key": (manifest(lambda m: m.pop("fps")), ["fps: expected frames per second, found no such key"]),
    "missing section": (manifest(lambda m: m.pop("splits")), ["splits: expected a section with the keys test_cameras"]),
    "unknown key with hint": (
        manifest(lambda m: m["images"].update(transfre="linear")),
        ["images.transfre", "unknown key; did you mean transfer?"],
    ),
    "unknown key": (manifest(lambda m: m.update(zebra=1)), ["capture.yaml: zebra: ", "an unknown key; remove it"]),
    "text for a number": (manifest(lambda m: m.update(fps="fast")), ["fps: expected a number, found text 'fast'"]),
    "number for a name": (
        manifest(lambda m: m["splits"].update(test_segments=[3])),
        ["splits.test_segments[0]: expected text", "found a number 3"],
    ),
    "true for a number": (
        manifest(lambda m: m["images"].update(black_level=True)),
        ["images.black_level: expected a number"],
    ),
    "fps zero": (manifest(lambda m: m.update(fps=0)), ["fps: expected greater than 0"]),
    "other format": (
        manifest(lambda m: m.update(format="lightstage-capture/2")),
        ["format: expected 'lightstage-capture/1'"],
    ),
    "subject with a space": (
        manifest(lambda m: m.update(subject="my subject")),
        ["subject: expected", "letters, digits"],
    ),
    "subject with a newline": (
        manifest(lambda m: m.update(subject="tiny\n")),
        ["subject: expected", "letters, digits"],
    ),
    "kind": (manifest(lambda m: m.update(kind="cat")), ["kind: expected 'body' or 'head', found text 'cat'"]),
    "millimetres": (manifest(lambda m: m.update(units="mm")), ["units: expected 'm'", "convert lights.csv to metres"]),
    "curve of images that have none": (
        manifest(lambda m: m["images"].update(path="images/{camera}/{frame:06d}.exr", transfer="srgb")),
        ["images.transfer: expected linear: OpenEXR files hold linear light", "found srgb"],
    ),
    "rate of another clock": (
        manifest(lambda m: m.update(fps=0.03)),
        ["frames.csv: timestamp_s: expected seconds, 33.3333 apart", "fps says (0.03)", "30 frames per second"],
    ),
    "z up": (manifest(lambda m: m.update(up="+z")), ["up: expected '+y'", "rotate the world"]),
    "absolute path": (
        manifest(lambda m: m.update(lights="/lights.csv")),
        ["lights: expected a path relative to the capture"],
    ),
    "path that climbs": (
        manifest(lambda m: m["template"].update(mesh="../template.glb")),
        ["template.mesh: expected a path that stays inside"],
    ),
    "pattern without frame": (
        manifest(lambda m: m["images"].update(path="images/{camera}.exr")),
        ["images.path", "placeholders {camera}, {frame:06d}"],
    ),
    "pattern with attribute": (
        manifest(lambda m: m["masks"].update(path="{camera.__class__}{frame}.png")),
        ["masks.path", "nothing else in braces"],
    ),
    "pattern with open brace": (
        manifest(lambda m: m["images"].update(path="{camera/{frame}.exr")),
        ["images.path", "pattern"],
    ),
    "image suffix": (
        manifest(lambda m: m["images"].update(path="{camera}/{frame}.jpg")),
        ["images.path: expected a path that ends in .exr"],
    ),
    "unknown method": (
        manifest(lambda m: m["calibration"]["lights"].update(method="ball")),
        ["calibration.lights.method: expected one of 'mirror_ball', 'known', 'earlier', found 'ball'"],
    ),
    "no method": (
        manifest(lambda m: m["calibration"]["color"].pop("method")),
        ["calibration.color.method: expected one of chart, known, none"],
    ),
    "section that is a list": (
        manifest(lambda m: m.update(template=[1])),
        ["template: expected a section of keys, found a list"],
    ),
    "unknown test camera": (
        manifest(lambda m: m["splits"].update(test_cameras=["middle"])),
        ["splits.test_cameras: expected one that", "middle"],
    ),
    "unknown test frame": (
        manifest(lambda m: m["splits"].update(test_frames=[77])),
        ["splits.test_frames", "found 77"],
    ),
    "unknown test segment": (
        manifest(lambda m: m["splits"].update(test_segments=["z"])),
        ["splits.test_segments", "found z"],
    ),
    "all cameras test": (
        manifest(lambda m: m["splits"].update(test_cameras=["left", "right"])),
        ["splits: expected some images that no split"],
    ),
    "all frames test": (
        manifest(lambda m: m["splits"].update(test_segments=["a", "b"])),
        ["splits: expected some images that no split"],
    ),
}


@pytest.mark.parametrize("name", MANIFEST_BREAKS)
def test_manifest_complaint(name: str, known: Path, tmp_path: Path) -> None:
    check_break(known, tmp_path, *MANIFEST_BREAKS[name])


def test_no_capture_folder(tmp_path: Path) -> None:
    assert "expected a capture folder, found none" in read_complaints(tmp_path / "nowhere")


def test_no_manifest(tmp_path: Path) -> None:
    (tmp_path / "capture").mkdir()
    assert "capture.yaml: expected the capture's description" in read_complaints(tmp_path / "capture")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("images: [", "expected valid YAML"),
        ("subject: a\nsubject: b\n", "the key 'subject' is there twice"),
        ("subject: !!python/object:os.system a", "expected valid YAML"),
        ("- a\n- b\n", "found a list"),
        ("", "found nothing"),
    ],
)
def test_manifest_is_no_mapping(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture/capture.yaml").write_text(content)
    assert words in read_complaints(tmp_path / "capture")
