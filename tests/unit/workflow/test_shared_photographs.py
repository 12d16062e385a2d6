"""Jobs that share the photographs of a calibration: which there are, and how large they are."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.shared_images import size_of_share
from pipeline.workflow.shared_photographs import (
    board_index,
    board_photographs,
    found_boards,
    lights_joined_size,
    lights_share_size,
    measured_lights,
    size_of_calibration,
)


def write_index(files, cameras, shots, **content):
    """calibration_cameras.json of so many cameras that all see a board in so many shots; its path."""
    views = [
        {"camera": f"c{n}", "view": view, "path": f"c{n}/{view}.png"} for n in range(cameras) for view in range(shots)
    ]
    path = Path(board_index(files))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"method": "charuco", "views": views, **content}))
    return path


@pytest.mark.parametrize(("least", "shares"), [(1, 320), (20, 16), (40, 8), (160, 2), (161, 0), (4096, 0)])
def test_photographs_of_boards_are_shared(project, least, shares):
    """320 of them: 8 cameras, 40 shots. A camera's own are shared where they are many."""
    files = JobFiles(project(chunk_images=least), "someone")
    index = write_index(files, 8, 40)
    assert found_boards(files, index) == [f"results/someone/found_boards/{n:04d}.parquet" for n in range(shares)]
    assert (size_of_calibration("calibrate_cameras", files).pixels == 0) == bool(shares)


def test_shots_that_are_left_out_are_nobodys(project):
    files = JobFiles(project(chunk_images=40, calibrate_cameras={"most_views": 10}), "someone")
    index = write_index(files, 8, 40)
    assert board_photographs(files, index) == 80
    assert len(found_boards(files, index)) == 2
    timed = json.loads(index.read_text())
    write_index(files, 8, 40, views=[{**view, "time_s": 0.1 * view["view"]} for view in timed["views"]])
    assert board_photographs(files, index) == 320


@pytest.mark.parametrize(
    "content",
    [None, "", {"method": "known"}, {"method": "features", "views": [{"camera": c, "view": 0} for c in "ab"]}],
)
def test_cameras_without_boards_and_captures_without_an_index_have_no_such_jobs(project, content):
    files = JobFiles(project(chunk_images=1), "someone")
    path = Path(board_index(files))
    if content is not None:
        path.parent.mkdir(parents=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    assert found_boards(files, path) == []


def test_size_of_a_share_of_boards_is_bounded_whatever_the_capture_holds(project):
    """Ten photographs count as a camera: as many had each camera of the runs whose costs were measured."""
    loaded = project(chunk_images=100)
    sizes = []
    for cameras in (8, 80, 800):
        files = JobFiles(loaded, "someone", chunk="0000")
        index = write_index(files, cameras, 25)
        assert len(found_boards(files, index)) == cameras // 4
        sizes.append(size_of_share("find_boards", files))
    assert [size.cameras for size in sizes] == [10, 10, 10]
    assert sizes[0] == sizes[1] == sizes[2]


@pytest.mark.parametrize(("least", "shares"), [(1, 8), (40, 4), (80, 2), (81, 0)])
def test_photographs_of_mirror_balls_are_shared_by_camera(project, least, shares):
    """160 of them: 8 cameras, 20 lights."""
    files = JobFiles(project(chunk_images=least), "someone")
    assert measured_lights(files) == [f"results/someone/measured_lights/{n:04d}.parquet" for n in range(shares)]
    assert lights_share_size(files).cameras == (-(-8 // shares) if shares else 8)
    assert (lights_joined_size(files).pixels == 0) == bool(shares)


@pytest.mark.parametrize(
    ("described", "shared"),
    [
        ({"calibration": {"lights": {"method": "mirror_ball"}}}, True),
        ({"calibration": {"lights": {"method": "known"}}}, False),
        ({"calibration": "nothing"}, False),
    ],
)
def test_recorded_captures_without_mirror_balls_have_no_such_jobs(project, tmp_path, described, shared):
    folder = tmp_path / "captures/someone"
    folder.mkdir(parents=True)
    (folder / "capture.yaml").write_text(yaml.safe_dump(described))
    assert bool(measured_lights(JobFiles(project(source="native", chunk_images=1), "someone"))) == shared
