"""Captures whose cameras are calibrated from the subject's features: what of them reaches the index."""

from __future__ import annotations

import pytest

from pipeline.base.errors import InputError
from pipeline.capture.index.validation import index_folder
from tests.support.captures.builder import CAMERAS, build_capture, edit_manifest, write_lines

DISTANCE = {"first": "left", "second": "right", "metres": 0.5}


def by_features(root, lights=None, **section):
    def change(manifest):
        manifest["calibration"]["cameras"] = {"method": "features", **section}
        manifest["calibration"]["lights"] = lights or manifest["calibration"]["lights"]

    edit_manifest(root, change)
    return root


@pytest.fixture
def capture(tmp_path):
    """Frame 0 is fully lit, by A and B."""
    return build_capture(tmp_path / "tiny", measured=True)


def test_fully_lit_images_are_views_with_masks_and_digests(capture):
    content = index_folder(by_features(capture, distance=DISTANCE)).contents["calibration_cameras"]
    assert [(view["camera"], view["view"]) for view in content["views"]] == [(camera, 0) for camera in CAMERAS]
    assert all(len(view["digest"]) == len(view["mask_digest"]) > 8 for view in content["views"])
    assert content["distance"] == DISTANCE and content["images"]["transfer"] == "linear"


def test_mirror_ball_gives_the_size_where_no_distance_does(capture):
    index = index_folder(by_features(capture)).contents
    assert index["calibration_cameras"]["silhouettes"] == index["calibration_lights"]["silhouettes"] != []
    assert index["calibration_cameras"]["radius_m"] == index["calibration_lights"]["radius_m"]


def test_rig_without_any_size_is_refused(capture):
    earlier = {"method": "earlier", "lights": "lights.parquet", "cameras": "cameras.json"}
    with pytest.raises(
        InputError, match="distance: expected a distance of two cameras, or mirror-ball images, found nei"
    ):
        index_folder(by_features(capture, earlier))


def test_distance_of_a_camera_that_is_none_is_refused(capture):
    with pytest.raises(InputError, match=r"distance: expected two cameras of the table .* found left and middle"):
        index_folder(by_features(capture, distance=DISTANCE | {"second": "middle"}))


def test_capture_without_a_fully_lit_frame_is_refused(capture):
    write_lines(capture / "patterns.csv", "frame,light,intensity", "0,A,1.0", "1,B,1.0")
    with pytest.raises(
        InputError, match=r"expected fully lit frames that are not held out, .* or calibrate with boards"
    ):
        index_folder(by_features(capture, distance=DISTANCE))
