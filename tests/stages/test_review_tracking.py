"""The stage on a walking figure whose tracking is the truth, but for one shifted frame and one knocked camera."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from rerun.chunk import RrdReader

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_arrays, write_json, write_table
from pipeline.config.review_tracking import ReviewTracking
from pipeline.figures.style import GRADE_COLORS
from pipeline.stages.review_tracking import run
from tests.support.captures.walking import DOWNSAMPLE, write_capture
from tests.support.figures.kept_figures import kept_figures, panel_named, texts
from tests.support.figures.painted import add_images
from tests.support.figures.walking import Motion, ring_of_cameras, walk

FRAMES, SLIPPED, KNOCKED, HELD_OUT = 12, 5, "cam03", "cam01"
SLIP_M = np.array([0.0, 0.08, 0.0], np.float32)


@pytest.fixture(scope="module")
def motion() -> Motion:
    return walk(FRAMES)


@pytest.fixture(scope="module")
def captured(motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("reviewed")
    paths = add_images(write_capture(folder, motion, rigged=False), motion, np.ones(FRAMES, bool))
    index, calibration = paths["index"], folder / "calibration"
    write_json(index / "capture.json", read_json(index / "capture.json") | {"subject": "walk<er"})
    keypoints = read_table(index / "keypoints_2d.parquet")
    keypoints.loc[keypoints.camera == KNOCKED, "x"] += 3.0
    write_table(index / "keypoints_2d.parquet", keypoints)
    for name in ("cameras", "lights"):
        calibration.mkdir(exist_ok=True)
        (calibration / paths[name].name).write_bytes(paths[name].read_bytes())
    patterns = read_table(paths["patterns"]).assign(fully_lit=lambda table: table.frame % 2 == 0)
    write_table(paths["patterns"], patterns[patterns.fully_lit | (patterns.light < "L05")])
    write_json(calibration / "color.json", {"cameras": {name: np.eye(3).tolist() for name in ring_of_cameras(6)}})
    chunks = [write_chunk(folder, motion, chunk) for chunk in (0, 1)]
    return {
        "capture": folder, "index": index, "calibration": calibration, "tracking": tuple(chunks),
        "patterns": paths["patterns"], "out": folder / "review",
    }  # fmt: skip


def write_chunk(folder: Path, motion: Motion, chunk: int) -> Path:
    frames = np.arange(FRAMES // 2) + chunk * FRAMES // 2
    vertices = motion.vertices[frames].astype(np.float32)
    vertices[frames == SLIPPED] += SLIP_M
    path, count = folder / f"tracking/{chunk:04d}.safetensors", len(frames)
    arrays = {
        "frames": frames, "vertices": vertices, "root_rotation": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        "root_translation": np.zeros((count, 3), np.float32), "keypoints": vertices[:, ::40],
    }  # fmt: skip
    write_arrays(path, arrays)
    slipped = frames == SLIPPED
    table = pd.DataFrame(
        {
            "frame": frames, "status": np.where(frames == 7, "interpolated", "tracked"), "masks": 5,
            "rms_px": np.where(slipped, 2.0, 0.5), "inliers": np.where(slipped, 30, 95), "observations": 100,
            "keypoints": 22, "silhouette_iou": np.where(slipped, 0.85, 0.98),
        }
    )  # fmt: skip
    write_table(path.with_suffix(".parquet"), table)
    return path


@pytest.fixture(scope="module")
def reviewed_and_drawn(captured: dict) -> tuple[Path, dict[str, Figure]]:
    with kept_figures() as figures:
        run(**captured, threads=2, settings=ReviewTracking(sheet_frames=4, most_cameras=3))
    return captured["out"], figures


@pytest.fixture(scope="module")
def reviewed(reviewed_and_drawn: tuple[Path, dict[str, Figure]]) -> Path:
    return reviewed_and_drawn[0]


@pytest.fixture(scope="module")
def drawn(reviewed_and_drawn: tuple[Path, dict[str, Figure]]) -> dict[str, Figure]:
    """Figures, by the names of their files."""
    return reviewed_and_drawn[1]


def test_pictures_are_there_and_on_the_page(reviewed: Path) -> None:
    pictures = {path.name for path in reviewed.glob("*.png")}
    assert {"errors.png", "worst.png", f"camera_{KNOCKED}.png"} <= pictures and len(pictures) == 5
    page = (reviewed / "index.html").read_text()
    assert set(re.findall(r'src="([^"]+)"', page)) == pictures
    assert "Tracking of walk&lt;er" in page and "python -m rerun tracking.rrd" in page


def test_what_is_wrong_has_a_verdict_and_nothing_else_has(reviewed: Path) -> None:
    verdicts = pd.read_csv(reviewed / "verdicts.csv", dtype=str).set_index(["kind", "name"])
    assert set(verdicts.index[verdicts.grade != "good"]) == {
        ("camera", KNOCKED), ("frame", str(SLIPPED)), ("frame", "7"),
    }  # fmt: skip
    slipped = verdicts.loc["frame", str(SLIPPED)]
    assert slipped.grade == "failed"
    for text in ("only 30% of the keypoints fit", "silhouettes do not overlap", "fit worse"):
        assert text in slipped.reason
    jump_mm = float(re.search(r"jumps by (\d+) mm", slipped.reason)[1])
    assert abs(jump_mm - 1e3 * SLIP_M.max()) < 8  # what the figure itself does in a frame comes to it
    assert verdicts.loc["frame", "7"].grade == "failed" and "interpolated" in verdicts.loc["frame", "7"].reason
    assert "was it moved" in verdicts.loc["camera", KNOCKED].reason
    assert "held out" in verdicts.loc["camera", HELD_OUT].reason


def test_every_frame_has_its_dot_and_failed_ones_their_band(drawn: dict[str, Figure]) -> None:
    errors, overlaps, counts, _ = drawn["errors.png"].axes
    slipped = np.arange(FRAMES) == SLIPPED
    for axes, values in ((errors, np.where(slipped, 2.0, 0.5)), (overlaps, np.where(slipped, 0.85, 0.98))):
        dots = np.concatenate([line.get_xydata() for line in axes.get_lines() if line.get_marker() == "o"])
        np.testing.assert_allclose(dots[dots[:, 0].argsort()], np.stack([np.arange(FRAMES), values], 1))
        bands = [(patch.get_x(), patch.get_width(), to_hex(patch.get_facecolor())) for patch in axes.patches]
        assert bands == [(frame - 0.5, 1.0, GRADE_COLORS["failed"]) for frame in (SLIPPED, 7)]
        lit = next(line for line in axes.get_lines() if line.get_marker() == "|")
        assert lit.get_xdata().tolist() == list(range(0, FRAMES, 2))
    heights = [[bar.get_height() for bar in group] for group in counts.containers]
    assert heights == [[100] * FRAMES, [30 if frame == SLIPPED else 95 for frame in range(FRAMES)]]


def test_sheets_mark_detections_that_fit_and_those_that_miss(captured: dict, drawn: dict[str, Figure]) -> None:
    """Of a camera that saw all well, and of one whose detections are 3 px aside."""
    table = read_table(captured["index"] / "keypoints_2d.parquet")
    missing = {}
    for name in ("cam00", KNOCKED):
        marks = offsets_of_marks(drawn[f"camera_{name}.png"], "frame 4")
        detected = table[(table.camera == name) & (table.frame == 4)][["x", "y"]].to_numpy(np.float64)
        drawn_at = np.concatenate([marks["fitting"], marks["missing"]])
        np.testing.assert_allclose(drawn_at[drawn_at[:, 0].argsort()], detected[detected[:, 0].argsort()], atol=1e-6)
        missing[name] = len(marks["missing"])
        apart = np.linalg.norm(marks["fitting"][:, None] - marks["crosses"], axis=2).min(1)
        assert apart.max() < ReviewTracking().outlier_px
    assert missing[KNOCKED] > 3 + 2 * missing["cam00"]
    titles = texts(drawn["worst.png"])
    assert any(f"frame {SLIPPED}: failed" in title for title in titles)
    assert any("frame 7: failed" in title for title in titles)


def offsets_of_marks(figure: Figure, panel: str) -> dict[str, np.ndarray]:
    """Places of detections near the template, of the others, and of crosses, in a panel of a sheet."""
    marks = [mark for mark in panel_named(figure, panel).collections if type(mark) is PathCollection]
    return dict(zip(("fitting", "missing", "crosses"), (np.asarray(mark.get_offsets()) for mark in marks), strict=True))


def columns(path: Path, entity: str, column: str) -> dict[int, np.ndarray]:
    """Frame -> values of a component in the recording."""
    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and column in batch.schema.names and "frame" in batch.schema.names:
            for frame, values in zip(batch["frame"].to_pylist(), batch[column].to_pylist(), strict=True):
                found[frame] = np.array(values)
    return found


def test_recording_holds_the_mesh_and_where_cameras_see_it(reviewed: Path, motion: Motion) -> None:
    path = reviewed / "tracking.rrd"
    done = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    expected = {"/stage/mesh", "/stage/lights", "/stage/keypoints/tracked", "/stage/keypoints/triangulated"}
    for name in ring_of_cameras(6):
        camera = f"/stage/cameras/{name}"
        expected |= {camera, f"{camera}/image", f"{camera}/image/detected", f"{camera}/image/tracked"}
    assert entities >= expected | {"/errors/keypoints_px", "/errors/overlap"}
    mesh = columns(path, "/stage/mesh", "Mesh3D:vertex_positions")
    assert sorted(mesh) == list(range(FRAMES))
    np.testing.assert_allclose(mesh[2], motion.vertices[2], atol=1e-6)
    camera = ring_of_cameras(6)["cam02"].downsampled(DOWNSAMPLE)
    rotation, _ = cv2.Rodrigues(camera.R)
    points = motion.vertices[2, ::40].astype(np.float32).astype(np.float64)
    expected_px, _ = cv2.projectPoints(points, rotation, camera.t, camera.opencv_K(), np.zeros(5))
    tracked = columns(path, "/stage/cameras/cam02/image/tracked", "Points2D:positions")[2]
    np.testing.assert_allclose(tracked, expected_px[:, 0] + 0.5, atol=1e-3)
    lights = columns(path, "/stage/lights", "Points3D:colors")
    bright = {frame: int((np.array(colors, np.uint32) > 0x40000000).sum()) for frame, colors in lights.items()}
    assert bright == {frame: 20 if frame % 2 == 0 else 5 for frame in range(FRAMES)}


def test_recording_images_show_the_subject_where_the_mesh_is(reviewed: Path, motion: Motion) -> None:
    blobs = columns(reviewed / "tracking.rrd", "/stage/cameras/cam00/image", "EncodedImage:blob")
    image = cv2.imdecode(np.array(blobs[4], np.uint8).ravel(), cv2.IMREAD_GRAYSCALE)
    camera = ring_of_cameras(6)["cam00"].downsampled(DOWNSAMPLE)
    rotation, _ = cv2.Rodrigues(camera.R)
    pixels, _ = cv2.projectPoints(motion.vertices[4], rotation, camera.t, camera.opencv_K(), np.zeros(5))
    column, row = np.round(pixels[:, 0]).astype(int).T
    on_subject = np.zeros(image.shape, np.uint8)
    on_subject[row, column] = 1
    near = cv2.dilate(on_subject, np.ones((9, 9), np.uint8)) > 0
    assert image[on_subject > 0].mean() > 5 * image[~near].mean()


def test_a_recording_that_would_get_too_large_leaves_frames_out(captured: dict, tmp_path: Path) -> None:
    settings = ReviewTracking(sheet_frames=1, most_cameras=1, recording_mb=0.1, recording_cameras=2)
    run(**{**captured, "out": tmp_path / "review"}, settings=settings)
    mesh = columns(tmp_path / "review/tracking.rrd", "/stage/mesh", "Mesh3D:vertex_positions")
    assert 0 in mesh and 1 <= len(mesh) < FRAMES
    assert (tmp_path / "review/tracking.rrd").stat().st_size < 300_000
    assert len(columns(tmp_path / "review/tracking.rrd", "/errors/overlap", "Scalars:scalars")) == FRAMES


def test_without_masks_and_recording_and_other_chunks_files(captured: dict, tmp_path: Path) -> None:
    images = read_table(captured["index"] / "images.parquet").assign(mask_path=None)
    index = tmp_path / "index"
    index.mkdir()
    for file in captured["index"].iterdir():
        (index / file.name).write_bytes(file.read_bytes())
    write_table(index / "images.parquet", images)
    paths = {**captured, "index": index, "out": tmp_path / "review"}
    run(**paths, settings=ReviewTracking(sheet_frames=1, most_cameras=1, recording=False))
    assert not (tmp_path / "review/tracking.rrd").exists()
    broken = tmp_path / "0000.safetensors"
    broken.write_bytes(captured["tracking"][0].read_bytes())
    write_table(broken.with_suffix(".parquet"), read_table(captured["tracking"][1].with_suffix(".parquet")))
    with pytest.raises(InputError, match=r"0000.parquet: expected the frames of 0000.safetensors"):
        run(**{**paths, "tracking": (broken,), "out": tmp_path / "other"})
    assert not (tmp_path / "other").exists()
