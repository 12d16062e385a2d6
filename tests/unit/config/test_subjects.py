"""What the workflow knows of a capture before anything has run."""

from __future__ import annotations

import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.config.loading import load_project
from pipeline.config.subjects import chunk_ids, dataset_files, require_subject, subject_names, watched_files

DESCRIPTION = {
    "format": "lightstage-capture/1",
    "frames": "tables/frames.csv",
    "lights": "lights.csv",
    "images": {"path": "images/{camera}/{frame:06d}.png", "black_level": 0.0},
    "template": {"mesh": "template.glb", "keypoints": "../outside.csv"},
}


@pytest.fixture
def folders(tmp_path):
    for name in ("captures/real/images/a", "captures/real/tables", "captures/empty", "subjects"):
        (tmp_path / name).mkdir(parents=True)
    real = tmp_path / "captures/real"
    (real / "capture.yaml").write_text(yaml.safe_dump(DESCRIPTION))
    (real / "tables/frames.csv").write_text("frame,timestamp_s,segment\n" + "".join(f"{f},0,a\n" for f in range(10)))
    for name in ("lights.csv", "template.glb", ".hidden", *(f"images/a/{f:06d}.png" for f in range(3))):
        (real / name).write_text("")
    (tmp_path / "captures/outside.csv").write_text("")
    (tmp_path / "subjects/made.yaml").write_text("source: synthetic\nsynthesize_capture: {frames: 9}\n")
    return tmp_path


def project_of(folders, **changes):
    return load_project({"captures": str(folders / "captures"), **changes}, changes, folders / "subjects")


def relative(paths, folders):
    return [path.removeprefix(str(folders / "captures") + "/") for path in paths]


def test_subjects_are_folders_with_a_description_and_synthetic_ones(folders):
    assert subject_names(project_of(folders)) == ["made", "real"]


def test_unknown_subject_is_told_what_is_missing_and_what_there_is(folders):
    project = project_of(folders)
    require_subject(project, "real")
    require_subject(project, "made")
    with pytest.raises(InputError, match=r"'empty': expected .*captures/empty/capture\.yaml.*subjects: made, real"):
        require_subject(project, "empty")


@pytest.mark.parametrize(("subject", "frames"), [("real", 10), ("made", 9)])
@pytest.mark.parametrize("size", [1, 3, 4, 9, 10, 64])
def test_chunks_cover_all_frames_without_an_empty_one(folders, subject, frames, size):
    chunks = chunk_ids(project_of(folders, chunk_frames=size), subject)
    assert chunks == [f"{chunk:04d}" for chunk in range(len(chunks))]
    assert (len(chunks) - 1) * size < frames <= len(chunks) * size


@pytest.mark.parametrize(
    "text",
    [
        "",
        "- a list",
        "frames: [",
        "frames: missing.csv",
        "frames: 3",
        "frames: lights.csv",
        "frames: .",
        "\x00",
        "é" * 9,
    ],
)
def test_broken_description_has_one_chunk(folders, text):
    (folders / "captures/real/capture.yaml").write_text(text, encoding="latin-1")
    project = project_of(folders)
    assert chunk_ids(project, "real") == ["0000"]
    assert watched_files(project, "real")


def test_small_capture_is_watched_file_by_file(folders):
    assert relative(watched_files(project_of(folders), "real"), folders) == [
        "real/capture.yaml",
        *(f"real/images/a/{f:06d}.png" for f in range(3)),
        "real/lights.csv",
        "real/tables/frames.csv",
        "real/template.glb",
    ]


def test_large_capture_is_watched_by_the_tables_that_it_names(folders):
    files = watched_files(project_of(folders, track_capture_files=6), "real")
    assert relative(files, folders) == [
        "real/capture.yaml",
        "real/lights.csv",
        "real/tables/frames.csv",
        "real/template.glb",
    ]
    assert len(watched_files(project_of(folders, track_capture_files=7), "real")) == 7


def test_synthetic_capture_is_watched_by_its_description(folders):
    assert relative(watched_files(project_of(folders), "made"), folders) == ["made/capture.yaml"]


def test_stray_files_stop_nothing(folders):
    """Names that Snakemake takes for wildcards, links to nothing, loops and devices belong to no capture."""
    project, real = project_of(folders), folders / "captures/real"
    before = watched_files(project, "real")
    (real / "notes {draft}.txt").touch()
    (real / "two\nlines.txt").touch()
    (real / "{images}").mkdir()
    (real / "{images}/a.png").touch()
    for name, target in (("dangling", "nothing"), ("loop", "loop"), ("device", "/dev/zero")):
        (real / name).symlink_to(target)
    assert watched_files(project, "real") == before
    (real / "notes.txt").touch()
    assert set(watched_files(project, "real")) - set(before) == {str(real / "notes.txt")}


@pytest.mark.parametrize("table", ["/dev/zero", "../outside.csv", "{folders}/captures/outside.csv", "tables"])
@pytest.mark.parametrize("limit", [1, 1000])
def test_tables_outside_the_capture_are_never_opened(folders, table, limit):
    (folders / "captures/outside.csv").write_text("frame\n" + "1\n" * 500)
    description = {**DESCRIPTION, "frames": table.format(folders=folders)}
    (folders / "captures/real/capture.yaml").write_text(yaml.safe_dump(description))
    project = project_of(folders, track_capture_files=limit)
    assert chunk_ids(project, "real") == ["0000"]
    root = str(folders / "captures/real")
    assert all(path.startswith(root) and ".." not in path for path in watched_files(project, "real"))


def test_a_large_public_set_is_watched_by_its_calibrations_and_archives(folders):
    place = folders / "set"
    for name in ("K.json", "image/cam1.zip", "sequences/a/lights.json", "sequences/a/images/cam/0.avif"):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text("")
    (folders / "subjects/shipped.yaml").write_text(f"source: goliath\npath: {place}\n")
    (folders / "subjects/gone.yaml").write_text(f"source: goliath\npath: {place}x\n")
    project = project_of(folders)
    assert subject_names(project) == ["gone", "made", "real", "shipped"]
    assert len(dataset_files(project, "shipped")) == 4
    few = dataset_files(project_of(folders, track_capture_files=3), "shipped")
    assert [path.removeprefix(f"{place}/") for path in few] == ["K.json", "image/cam1.zip", "sequences/a/lights.json"]
    with pytest.raises(InputError, match=r"gone\.yaml: path: expected the folder of a goliath capture, found none"):
        dataset_files(project, "gone")
