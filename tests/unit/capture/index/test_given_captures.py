"""A tiny capture whose images, masks, colours and meshes are given in other ways: read alike, or each fault named."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.capture.images import ImageSource
from pipeline.capture.index.validation import index_folder
from tests.support.captures.broken import check_break, manifest, read_complaints
from tests.support.captures.builder import CAMERAS, FRAMES, HEIGHT, WIDTH, build_capture, edit_manifest, save


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_capture(tmp_path_factory.mktemp("plain") / "tiny")


@pytest.fixture
def capture(plain: Path, tmp_path: Path) -> Path:
    return shutil.copytree(plain, tmp_path / "capture")


def into_archives(capture: Path) -> None:
    for camera in CAMERAS:
        with zipfile.ZipFile(capture / f"images/{camera}.zip", "w") as archive:
            for frame in FRAMES:
                archive.write(capture / f"images/{camera}/{frame:06d}.exr", f"in/{frame:06d}.exr")
        shutil.rmtree(capture / "images" / camera)
    pattern = "images/{camera}.zip/in/{frame:06d}.exr"
    edit_manifest(capture, lambda content: content["images"].update(path=pattern))


def image_rows() -> pd.DataFrame:
    rows = [(c, f, f"images/{c}/{f:06d}.exr", f"masks/{c}/{f:06d}.png") for c in CAMERAS for f in FRAMES]
    return pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])


def list_images(capture: Path, table: pd.DataFrame) -> None:
    table.to_parquet(capture / "images.parquet")

    def change(content: dict) -> None:
        content["images"].pop("path")
        content["images"]["table"] = "images.parquet"
        content.pop("masks", None)

    edit_manifest(capture, change)


def test_images_in_archives_are_the_same_images(plain: Path, capture: Path) -> None:
    expected = index_folder(plain).tables["images"]
    into_archives(capture)
    found = index_folder(capture).tables["images"]
    assert found.path.tolist() == [f"images/{c}.zip/in/{f:06d}.exr" for c in CAMERAS for f in FRAMES]
    pd.testing.assert_frame_equal(found.drop(columns="path"), expected.drop(columns="path"))
    pixels = ImageSource(capture, "linear", 0.0).read(found.path[4], None)
    np.testing.assert_array_equal(pixels, ImageSource(plain, "linear", 0.0).read(expected.path[4], None))


def test_a_member_that_is_missing_is_a_missing_image(capture: Path) -> None:
    into_archives(capture)
    with zipfile.ZipFile(capture / "images/left.zip", "w") as archive:
        archive.writestr("in/000000.exr", b"")
    assert "images: left: expected one for each frame, found 2 of 3 images missing: 1, 2" in read_complaints(capture)


def test_listed_images_may_lack_masks_and_frames(capture: Path) -> None:
    table = image_rows()
    table.loc[1, "mask_path"] = None
    list_images(capture, table.drop(index=5))
    found = index_folder(capture).tables["images"]
    assert len(found) == 5 and found.mask_path.isna().tolist() == [False, True, False, False, False]


@pytest.mark.parametrize(
    ("row", "column", "value", "expected"),
    [
        (0, "camera", "middle", "images.parquet: camera: expected names that the table of cameras lists"),
        (0, "frame", 7, "images.parquet: frame: expected"),
        (2, "path", "images/left/none.exr", "images.parquet: path: expected images, found 1 that are not there"),
        (2, "path", "../left/000002.exr", "images.parquet: path: expected paths relative to the capture"),
        (0, "frame", 1, "images.parquet"),
    ],
)
def test_wrong_rows_of_listed_images_are_named(
    capture: Path, row: int, column: str, value: object, expected: str
) -> None:
    table = image_rows()
    table.loc[row, column] = value
    list_images(capture, table)
    message = read_complaints(capture)
    assert expected.split(": expected")[0] in message


def test_a_pattern_and_a_table_exclude_each_other(plain: Path, tmp_path: Path) -> None:
    both = manifest(lambda content: content["images"].update(table="images.parquet"))
    check_break(plain, tmp_path / "both", both, ["images.path: expected a pattern", "or else images.table"])
    neither = manifest(lambda content: content["images"].pop("path"))
    check_break(plain, tmp_path / "neither", neither, ["images.path: expected a pattern", "found nothing"])


def test_part_labels_may_be_smaller_than_their_images(capture: Path) -> None:
    labels = np.array([[0, 1, 2, 3], [4, 4, 0, 0], [3, 3, 1, 1]], np.uint8)
    for path in capture.glob("masks/*/*.png"):
        save(path, labels)
    edit_manifest(capture, lambda content: content["masks"].update(labels=[1, 4], enlarged=True))
    index = index_folder(capture)
    facts = index.contents["capture"]["images"]
    assert facts["masks"] == {"labels": (1, 4), "enlarged": True}
    mask = ImageSource.from_index(capture, facts).read_mask("masks/left/000000.png", (HEIGHT, WIDTH, 3))
    np.testing.assert_array_equal(mask, np.kron(np.isin(labels, (1, 4)), np.ones((2, 2))) * 255)


def test_black_levels_may_differ_by_channel(capture: Path) -> None:
    edit_manifest(capture, lambda content: content["images"].update(black_level=[0.25, 0.0, 0.5]))
    facts = index_folder(capture).contents["capture"]["images"]
    path = "images/left/000000.exr"
    raw, found = (
        ImageSource(capture, "linear", 0.0).read(path, None),
        ImageSource.from_index(capture, facts).read(path, None),
    )
    np.testing.assert_allclose(raw - found, np.broadcast_to([0.25, 0.0, 0.5], raw.shape), atol=1e-6)
    edit_manifest(capture, lambda content: content["images"].update(black_level=[0.25, 0.0]))
    assert "images.black_level: expected" in read_complaints(capture)


def give_colors(capture: Path, matrices: dict) -> None:
    (capture / "color.json").write_text(json.dumps({"cameras": matrices}))
    edit_manifest(
        capture, lambda content: content["calibration"].update(color={"method": "known", "path": "color.json"})
    )


def test_known_colours_are_matrices_with_or_without_a_column(capture: Path) -> None:
    matrices = {"left": np.diag([1.4, 1.1, 1.6]).tolist(), "right": np.eye(3, 4).tolist()}
    give_colors(capture, matrices)
    assert index_folder(capture).contents["calibration_color"]["cameras"] == matrices
    give_colors(capture, {"left": np.zeros((3, 3)).tolist()})
    message = read_complaints(capture)
    assert "color.json: camera left: expected 3 rows of finite numbers, as many as 3, 4, 5" in message
    assert "color.json: camera right: expected 3 rows of finite numbers, as many as 3, 4, 5" in message


def give_meshes(capture: Path, vertices: int = 4, pose: object = None, frame: int = 0) -> None:
    head = f"ply\nformat ascii 1.0\nelement vertex {vertices}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    (capture / "mesh.ply").write_text(f"{head}end_header\n" + "1 2 3\n" * vertices)
    table = pd.DataFrame({"frame": [frame], "path": ["mesh.ply"], "world_from_mesh": [pose]})
    table.to_parquet(capture / "meshes.parquet")
    edit_manifest(capture, lambda content: content.update(meshes={"table": "meshes.parquet", "scale_to_m": 0.001}))


def test_given_meshes_are_indexed_with_their_poses(capture: Path) -> None:
    pose = np.eye(3, 4).ravel().tolist()
    give_meshes(capture, pose=pose)
    index = index_folder(capture)
    assert index.contents["capture"]["meshes"] == {"motion": "given", "scale_to_m": 0.001}
    meshes = index.tables["meshes"]
    assert meshes.frame.tolist() == [0] and meshes.world_from_mesh[0].tolist() == pose and meshes.digest[0]


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"vertices": 5}, "mesh.ply: expected the template's 4 vertices, found 5"),
        ({"pose": [1.0] * 12}, "world_from_mesh: expected 12 numbers, the rows of [R | t] with a rotation R"),
        ({"frame": 9}, "meshes.parquet: frame"),
    ],
)
def test_wrong_meshes_are_named(capture: Path, wrong: dict, expected: str) -> None:
    give_meshes(capture, **wrong)
    assert expected in read_complaints(capture)


def test_only_an_imported_capture_has_images_behind_its_link(capture: Path, tmp_path: Path) -> None:
    shutil.move(capture / "images", tmp_path / "elsewhere")
    (capture / "source").symlink_to(tmp_path / "elsewhere")
    pattern = "source/{camera}/{frame:06d}.exr"
    edit_manifest(capture, lambda content: content["images"].update(path=pattern))
    assert "expected a file inside the capture folder, found a link" in read_complaints(capture)
    notes = {"dataset": "x", "digest": "", "given": {}, "computed": {}, "left_out": {}}
    edit_manifest(capture, lambda content: content.update(imported=notes))
    assert len(index_folder(capture).tables["images"]) == 6
    (tmp_path / "elsewhere/left/000000.exr").unlink()
    (tmp_path / "elsewhere/left/000000.exr").symlink_to("/etc/hostname")
    assert "expected a file inside the capture folder" in read_complaints(capture)
