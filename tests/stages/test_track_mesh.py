"""The stage on a figure whose motion is known: accuracy, gaps, outliers, chunks, unrigged templates, bad input."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_table
from pipeline.config.track_mesh import TrackMesh
from pipeline.stages.track_mesh import run
from tests.support.captures.walking import OUTLIERS, edited, mean_error_mm, with_template_scale, write_capture
from tests.support.figures.painted import add_images
from tests.support.figures.walking import BONES, Motion, walk


@pytest.fixture(scope="module")
def motion() -> Motion:
    return walk(12)


@pytest.fixture(scope="module")
def captured(motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> dict:
    return write_capture(tmp_path_factory.mktemp("walk"), motion)


def test_vertices_are_found_to_millimetres(captured: dict, motion: Motion) -> None:
    run(**captured, chunk=0)
    # 5 cameras of 0.35 px at 12 mm per pixel: joints good to about 3 mm each, less what smoothness averages away.
    assert mean_error_mm(captured, motion) < 4.0
    table = read_table(captured["out"] / "0000.parquet")
    assert table.frame.tolist() == list(range(12))
    assert (table.status == "tracked").all()
    assert table.rms_px.between(0.25, 1.0).all()
    assert (table.silhouette_iou > 0.93).all()
    share = table.inliers.sum() / table.observations.sum()
    assert 1 - 2 * OUTLIERS < share < 1 - 0.5 * OUTLIERS
    result = read_arrays(captured["out"] / "0000.safetensors")
    assert result["vertices"].dtype == np.float32
    assert result["joint_rotations"].shape == (12, len(BONES), 4)
    assert result["root_rotation"].shape == (12, 4)
    assert result["root_translation"].shape == (12, 3)


def test_silhouettes_find_what_keypoints_leave_open(captured: dict, motion: Motion, tmp_path: Path) -> None:
    errors = {}
    for rounds in (0, 5):
        paths = captured | {"out": tmp_path / str(rounds)}
        run(**paths, chunk=0, settings=TrackMesh(outline_rounds=rounds))
        errors[rounds] = mean_error_mm(paths, motion)
    assert errors[5] < 0.5 * errors[0]


def test_interpolated_silhouettes_help_slow_limbs(tmp_path: Path) -> None:
    slow = walk(9, fps=96.0)
    captured = write_capture(tmp_path, slow)
    images, masked = read_table(captured["index"] / "images.parquet"), np.arange(9) % 2 == 0
    images.loc[~masked[images.frame], "mask_path"] = None
    paths, errors = edited(captured, tmp_path / "gaps", images=images), {}
    for gap in (0, 1):
        out = paths | {"out": tmp_path / str(gap)}
        run(**out, chunk=0, settings=TrackMesh(outline_rounds=4, mask_gap_frames=gap, interpolated_sigma_px=1.0))
        vertices = read_arrays(tmp_path / str(gap) / "0000.safetensors")["vertices"]
        errors[gap] = np.linalg.norm(vertices - slow.vertices, axis=-1)[~masked].mean()
    assert errors[1] < 0.95 * errors[0]
    table = read_table(tmp_path / "1/0000.parquet")
    assert table.masks.tolist() == np.where(masked, 5, 0).tolist()
    assert table.masks_interpolated.tolist() == np.where(masked, 0, 5).tolist()


def test_images_find_how_limbs_twist_and_carry_it_to_frames_between(motion: Motion, tmp_path: Path) -> None:
    paths = write_capture(tmp_path, motion)
    lit = np.arange(len(motion.times_s)) % 3 == 0
    lit_paths = add_images(paths, motion, lit)
    errors = {}
    for rounds in (0, 3):
        out = tmp_path / str(rounds)
        run(**lit_paths | {"out": out}, chunk=0, settings=TrackMesh(outline_rounds=3, image_rounds=rounds))
        vertices = read_arrays(out / "0000.safetensors")["vertices"]
        error = 1e3 * np.linalg.norm(vertices - motion.vertices, axis=-1)
        errors[rounds] = error[lit].mean(), error[~lit].mean()
    # The images tie the twists of all lit frames together; where a limb is round, the common twist remains open.
    assert errors[3][0] < 0.9 * errors[0][0]
    assert errors[3][1] < 0.95 * errors[0][1]
    table = read_table(tmp_path / "3/0000.parquet")
    assert table.status.tolist() == np.where(lit, "refined", "carried").tolist()
    assert (table.silhouette_iou > 0.93).all()


def test_output_is_the_same_every_time_and_chunks_join(captured: dict, motion: Motion, tmp_path: Path) -> None:
    settings = TrackMesh(outline_rounds=1, context_frames=4)
    for out in (tmp_path / "a", tmp_path / "b"):
        for chunk in (0, 1):
            run(**captured | {"out": out}, chunk=chunk, chunk_size=6, settings=settings)
    for name in ("0000.safetensors", "0001.safetensors"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    first, second = (read_arrays(tmp_path / "a" / f"000{c}.safetensors") for c in (0, 1))
    assert second["frames"].tolist() == [6, 7, 8, 9, 10, 11]
    step = np.linalg.norm(second["vertices"][0] - first["vertices"][-1], axis=-1)
    true_step = np.linalg.norm(motion.vertices[6] - motion.vertices[5], axis=-1)
    # The median: the twist of a nearly round limb is hardly seen, and may differ from chunk to chunk.
    assert np.median(np.abs(step - true_step)) < 1e-3
    with pytest.raises(InputError, match="chunk: expected 0 to 1, found 2"):
        run(**captured, chunk=2, chunk_size=6)


def test_frames_without_keypoints_are_interpolated_and_say_so(captured: dict, motion: Motion, tmp_path: Path) -> None:
    keypoints = read_table(captured["index"] / "keypoints_2d.parquet")
    paths = edited(captured, tmp_path, keypoints_2d=keypoints[~keypoints.frame.isin([0, 5, 6])])
    run(**paths, chunk=0, settings=TrackMesh(outline_rounds=2))
    table = read_table(paths["out"] / "0000.parquet")
    assert table.status.tolist() == ["interpolated"] + ["tracked"] * 4 + ["interpolated"] * 2 + ["tracked"] * 5
    assert table.frame[table.rms_px.isna()].tolist() == [0, 5, 6]  # nothing was measured, so nothing fits
    result = read_arrays(paths["out"] / "0000.safetensors")
    assert np.isfinite(result["vertices"]).all()
    assert np.array_equal(result["vertices"][0], result["vertices"][1])
    error = np.linalg.norm(result["vertices"][5:7] - motion.vertices[5:7], axis=-1).mean()
    # A third of the way between frames 4 and 7: a half sine of 1 Hz sags by a few centimetres at most at a hand.
    assert error < 0.02


def test_held_out_cameras_take_no_part(captured: dict, tmp_path: Path) -> None:
    keypoints = read_table(captured["index"] / "keypoints_2d.parquet")
    keypoints.loc[keypoints.camera == "cam01", ["x", "y"]] += 50.0
    paths = edited(captured, tmp_path, keypoints_2d=keypoints)
    settings = TrackMesh(outline_rounds=1)
    run(**paths, chunk=0, settings=settings)
    run(**captured | {"out": tmp_path / "plain"}, chunk=0, settings=settings)
    assert (paths["out"] / "0000.safetensors").read_bytes() == (tmp_path / "plain/0000.safetensors").read_bytes()


def test_unrigged_template_moves_rigidly(tmp_path: Path) -> None:
    motion = walk(6, rigid=True)
    paths = write_capture(tmp_path, motion, rigged=False, cameras=5)
    run(**paths, chunk=0)
    assert mean_error_mm(paths, motion) < 2.0
    assert "joint_rotations" not in read_arrays(paths["out"] / "0000.safetensors")


def test_capture_without_masks_or_with_one_frame_works(motion: Motion, tmp_path: Path) -> None:
    one = Motion(motion.times_s[:1], motion.joints[:1], motion.vertices[:1], motion.faces)
    paths = write_capture(tmp_path, one, masks=False)
    run(**paths, chunk=0)
    assert np.isnan(read_table(paths["out"] / "0000.parquet").silhouette_iou).all()
    result = read_arrays(paths["out"] / "0000.safetensors")
    assert np.linalg.norm(result["vertices"] - one.vertices, axis=-1).mean() < 0.05


def test_bad_input_says_what_to_do(captured: dict, tmp_path: Path) -> None:
    keypoints = read_table(captured["index"] / "keypoints_2d.parquet")
    images = read_table(captured["index"] / "images.parquet")

    def complaint(name: str, **tables: pd.DataFrame) -> str:
        (tmp_path / name).mkdir()
        with pytest.raises(InputError) as caught:
            run(**edited(captured, tmp_path / name, **tables), chunk=0)
        return str(caught.value)

    assert "at least 2 cameras" in complaint("one", images=images[images.camera == "cam00"])
    assert "run a 2D detector" in complaint("none", keypoints_2d=keypoints[:0])
    assert "expected names of template.keypoints" in complaint("other", keypoints_2d=keypoints.assign(keypoint="nose"))
    assert "one row per frame" in complaint("twice", keypoints_2d=pd.concat([keypoints, keypoints[:1]]))
    scattered = keypoints.assign(x=np.random.default_rng(0).uniform(0, 160, len(keypoints)))
    assert "two cameras agree" in complaint("one_camera", keypoints_2d=scattered[scattered.camera == "cam00"])

    with pytest.raises(InputError, match=r"set template.scale_to_m in capture.yaml to about 0\.0"):
        run(**with_template_scale(captured, tmp_path, 1.0), chunk=0)


class TestMisfit:
    """What belongs to something else than the images ends the run, with the number that tells."""

    def told(self, captured: dict, folder: Path, **tables: pd.DataFrame) -> str:
        with pytest.raises(InputError) as caught:
            run(**edited(captured, folder, **tables), chunk=0)
        assert not list((folder / "tracking").glob("*.safetensors"))
        return str(caught.value)

    @pytest.mark.parametrize("change", [lambda mask: 255 - mask, np.ones_like])
    def test_inverted_and_white_masks(self, captured: dict, tmp_path: Path, change) -> None:
        capture = tmp_path / "capture"
        shutil.copytree(captured["capture"], capture)
        for path in set(read_table(captured["index"] / "images.parquet").mask_path):
            mask = cv2.imread(str(capture / path), cv2.IMREAD_GRAYSCALE)
            cv2.imwrite(str(capture / path), change(mask) if change is not np.ones_like else np.full_like(mask, 255))
        said = self.told(captured | {"capture": capture}, tmp_path)
        assert "masks: all cameras: expected masks that overlap the tracked template by 0.7 or more" in said
        assert "is the subject 255" in said

    def test_exchanged_masks_of_two_cameras(self, captured: dict, tmp_path: Path) -> None:
        images = read_table(captured["index"] / "images.parquet").sort_values(["camera", "frame"], ignore_index=True)
        first, second = (images.camera == name for name in ("cam00", "cam02"))
        images.loc[first, "mask_path"], images.loc[second, "mask_path"] = (
            images.mask_path[second].to_numpy(), images.mask_path[first].to_numpy()
        )  # fmt: skip
        said = self.told(captured, tmp_path, images=images)
        assert "masks: cam00, cam02: expected masks that overlap" in said and "exchanged with others'?" in said

    def test_exchanged_coordinates_of_keypoints(self, captured: dict, tmp_path: Path) -> None:
        keypoints = read_table(captured["index"] / "keypoints_2d.parquet").rename(columns={"x": "y", "y": "x"})
        assert "keypoints_2d: x, y: expected at least 50% of the detections" in self.told(
            captured, tmp_path, keypoints_2d=keypoints
        )

    def test_run_goes_on_if_asked_to(self, captured: dict, tmp_path: Path) -> None:
        keypoints = read_table(captured["index"] / "keypoints_2d.parquet").rename(columns={"x": "y", "y": "x"})
        paths = edited(captured, tmp_path, keypoints_2d=keypoints)
        run(**paths, chunk=0, settings=TrackMesh(on_misfit="warn"))
        assert (paths["out"] / "0000.safetensors").exists()
