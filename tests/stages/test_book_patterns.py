"""The bookkeeping stage on a planted one: images as bright as a traced figure, under a log that may be wrong."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.capture.images import write_png
from pipeline.config.book_patterns import BookPatterns
from pipeline.geometry.cameras import Camera, write_cameras
from pipeline.stages.book_patterns import run
from tests.support.rigs.light_stage import Stage, build_stage, pattern_table, photograph, random_groups

FRAMES, SIZE = 30, 24
CAPPED = "c4"
"""A camera whose lens cap was left on."""


def camera_at(place: np.ndarray) -> Camera:
    """Looks at the origin; the masks below are the outline of the figure, 0.3 m x 0.85 m half axes."""
    forward = -place / np.linalg.norm(place)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[28.0, 0, SIZE / 2], [0, 28.0, SIZE / 2], [0, 0, 1]])
    return Camera(R, -R @ place, K, np.zeros(5), SIZE, SIZE)


@dataclass(frozen=True)
class Planted:
    """A capture on disk, and the figure in it to plant faults with."""

    root: Path
    figure: Stage
    log: np.ndarray

    def index(self, folder: Path, log: np.ndarray | None = None, first: int = 0, images=None) -> Path:
        """A copy of the index under another log or with other images; the log is cut to the capture's frames."""
        shutil.copytree(self.root / "index", folder)
        table = pattern_table(self.log if log is None else log, self.figure.names, first)
        table[table.frame.between(0, FRAMES - 1)].to_parquet(folder / "patterns.parquet")
        if images is not None:
            images(pd.read_parquet(folder / "images.parquet")).to_parquet(folder / "images.parquet")
        return folder


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Planted:
    """A capture whose log is right: an ellipse as bright as the figure, times a camera's gain, on a bright ground."""
    root = tmp_path_factory.mktemp("stage")
    rng = np.random.default_rng(1)
    figure = build_stage(2, frames=FRAMES, cameras=5, lights=16)
    log = random_groups(figure, rng)
    seen = photograph(figure, log, rng)
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
    outline = ((x - SIZE / 2) / 3.4) ** 2 + ((y - SIZE / 2) / 9.5) ** 2 < 1
    rows = []
    for c in range(5):
        camera = f"c{c}"
        write_png(root / f"masks/{camera}.png", outline.astype(np.uint8) * 255)
        for frame in range(FRAMES):
            shown = np.where(outline[..., None], 0.1 * seen[frame, c] * (camera != CAPPED), 0.9)
            write_exr(root / f"{camera}/{frame}.exr", shown + 0.05)
            flags = {"test_camera": False, "test_frame": frame == 7, "test_segment": frame >= 27,
                     "test_pattern": frame == 13, "validation_frame": False, "validation_pattern": False}  # fmt: skip
            files = {"path": f"{camera}/{frame}.exr", "mask_path": f"masks/{camera}.png"}
            rows.append({"camera": camera, "frame": frame, **files, **flags})
    (root / "index").mkdir()
    pd.DataFrame(rows).to_parquet(root / "index/images.parquet")
    pattern_table(log, figure.names).to_parquet(root / "index/patterns.parquet")
    frames = pd.DataFrame({"frame": range(FRAMES), "timestamp_s": np.arange(FRAMES) / 24, "segment": "a"})
    frames.to_parquet(root / "index/frames.parquet")
    facts = {"images": {"transfer": "linear", "black_level": 0.05, "downsample_from_sensor": 1}}
    (root / "index/capture.json").write_text(json.dumps(facts))
    lights = pd.DataFrame(figure.lights, columns=["x", "y", "z"]).assign(light=figure.names)
    lights.to_parquet(root / "lights.parquet")
    write_cameras(root / "cameras.json", {f"c{i}": camera_at(place) for i, place in enumerate(figure.cameras)})
    return Planted(root, figure, log)


def book(
    stage: Planted, out: Path, index: Path | None = None, **settings: object
) -> tuple[pd.DataFrame, pd.DataFrame, dict]:
    run(
        capture=stage.root,
        index=index or stage.root / "index",
        lights=stage.root / "lights.parquet",
        cameras=stage.root / "cameras.json",
        out=out,
        settings=BookPatterns(**settings),
    )
    sync = json.loads((out / "sync.json").read_text())
    return pd.read_parquet(out / "frames.parquet"), pd.read_parquet(out / "patterns.parquet"), sync


@pytest.fixture(scope="module")
def right(stage, tmp_path_factory):
    """The folder and the tables that a true log gives."""
    out = tmp_path_factory.mktemp("right")
    return out, *book(stage, out)


def test_a_true_log(right):
    out, frames, patterns, sync = right
    assert (sync["offset_frames"], sync["verdict"], sync["faults"], sync["fixed"]) == (0, "in_sync", [], False)
    assert sync["offset_changes"] == []
    np.testing.assert_allclose(sync["subject_center_m"], 0, atol=0.02)
    np.testing.assert_allclose(sorted(sync["subject_semiaxes_m"]), [0.3, 0.3, 0.85], rtol=0.15)
    assert frames.columns.tolist() == [
        "frame", "timestamp_s", "segment", "lights_on", "fully_lit", "pattern", "test_pattern", "split", "validation",
        "predicted", "observed", "suspicious",
    ]  # fmt: skip
    assert frames.fully_lit[::3].all()
    assert frames.lights_on.max() == 16
    counts = {"train": 25, "test_segments": 3, "test_frames": 1, "test_patterns": 1}
    assert frames.split.value_counts().to_dict() == counts
    assert frames.frame[frames.test_pattern].tolist() == [13]
    assert frames.pattern[::3].eq(0).all()
    ratio = frames.observed / frames.predicted
    assert ratio.std() < 0.1 * ratio.mean()  # gain, mask, black level
    assert not frames.suspicious.any()
    assert patterns.columns.tolist() == [
        "frame", "light", "intensity_r", "intensity_g", "intensity_b", "fully_lit", "split",
    ]  # fmt: skip
    assert (out / "sync.png").read_bytes()[:4] == b"\x89PNG"


def test_a_fault_is_an_error_that_says_how_to_mend_it(stage, tmp_path):
    with pytest.raises(InputError, match=r"\+3 frames away.*subtract 3.*on_desync"):
        book(stage, tmp_path / "out", stage.index(tmp_path / "index", first=3))
    assert (tmp_path / "out/sync.png").exists()
    assert not (tmp_path / "out/patterns.parquet").exists()


def test_all_faults_are_said_at_once(stage, tmp_path):
    log = stage.log.copy()
    log[11] = log[0]
    index = stage.index(tmp_path / "index", log, first=1)
    with pytest.raises(InputError, match=r"2 problems[\s\S]*\+1 frames away[\s\S]*frame 11 does not show its pattern"):
        book(stage, tmp_path / "out", index)


@pytest.mark.parametrize("offset", [-4, 1])
def test_an_offset_is_fixed(stage, right, tmp_path, offset):
    _, right_frames, right_patterns, _ = right
    index = stage.index(tmp_path / "index", first=offset)
    frames, patterns, sync = book(stage, tmp_path / "out", index, on_desync="fix")
    assert (sync["offset_frames"], sync["fixed"], sync["verdict"]) == (offset, True, "faulty")
    assert len(frames) == FRAMES - abs(offset)
    kept = right_frames[right_frames.frame.isin(frames.frame)].reset_index(drop=True)
    # Numbers after the fix are those of the images: everything is as if the log had been right.
    compared = ["frame", "timestamp_s", "segment", "lights_on", "fully_lit", "test_pattern", "split"]
    pd.testing.assert_frame_equal(frames[compared], kept[compared])
    expected = right_patterns[right_patterns.frame.isin(frames.frame)].reset_index(drop=True)
    pd.testing.assert_frame_equal(patterns, expected)


def test_a_lost_image_is_fixed(stage, tmp_path):
    """The images from frame 12 on are those of one frame later."""

    def lose(images: pd.DataFrame) -> pd.DataFrame:
        moved = images[images.frame != 12].copy()
        moved["frame"] -= moved.frame > 12
        return moved

    index = stage.index(tmp_path / "index", images=lose)
    frames, patterns, sync = book(stage, tmp_path / "out", index, on_desync="fix")
    assert sync["offset_changes"] == [{"frame": 12, "offset_frames": 1}]
    assert [fault["kind"] for fault in sync["faults"]] == ["missing_image"]
    for frame in frames.frame:
        lit = np.flatnonzero(stage.log[frame + (frame >= 12)].any(1))
        assert patterns.light[patterns.frame == frame].tolist() == [stage.figure.names[i] for i in lit]


def test_a_dead_light_and_a_wrong_frame_are_booked_as_they_were(stage, tmp_path):
    """The log lists a light that never lit, as the fully lit frames are logged without it."""
    log = np.concatenate([stage.log, np.zeros((FRAMES, 1, 3))], 1)
    rng = np.random.default_rng(0)
    claimed = rng.permutation(FRAMES)[:14]
    log[claimed, -1] = 6.0
    log[19] = log[1]
    lights = pd.read_parquet(stage.root / "lights.parquet")
    lights.loc[len(lights)] = {"light": "dead", "x": 0.3, "y": 1.0, "z": 2.0}
    lights.to_parquet(tmp_path / "lights.parquet")
    index = tmp_path / "index"
    shutil.copytree(stage.root / "index", index)
    pattern_table(log, lights.light.tolist()).to_parquet(index / "patterns.parquet")
    inputs = {"capture": stage.root, "index": index, "lights": tmp_path / "lights.parquet",
              "cameras": stage.root / "cameras.json", "out": tmp_path / "out"}  # fmt: skip
    run(**inputs, settings=BookPatterns(on_desync="fix"))
    sync = json.loads((tmp_path / "out/sync.json").read_text())
    assert sorted((f["kind"], f["name"]) for f in sync["faults"]) == [("dead_light", "dead"), ("wrong_pattern", "19")]
    frames, patterns = (pd.read_parquet(tmp_path / f"out/{name}.parquet") for name in ("frames", "patterns"))
    assert 19 not in frames.frame.tolist()
    assert "dead" not in set(patterns.light)
    assert frames.fully_lit[frames.frame % 3 == 0].all()  # every light that works is on


def test_a_fault_is_ignored_on_demand(stage, tmp_path):
    """All frames stay; the one whose light the log does not have is said to be suspicious."""
    log = stage.log.copy()
    log[19] = log[1]
    index = stage.index(tmp_path / "index", log, first=2)
    frames, patterns, sync = book(stage, tmp_path / "out", index, on_desync="ignore")
    assert (sync["offset_frames"], sync["fixed"]) == (2, False)
    assert len(frames) == FRAMES
    assert frames.frame[frames.suspicious].tolist() == [19]
    assert patterns.frame.min() == 2


@pytest.mark.parametrize("mode", ["error", "fix"])
def test_the_log_of_something_else_cannot_be_fixed(stage, tmp_path, mode):
    log = random_groups(stage.figure, np.random.default_rng(77), every=7)
    with pytest.raises(InputError, match="little to do with the log"):
        book(stage, tmp_path / "out", stage.index(tmp_path / "index", log), on_desync=mode)


def test_held_out_light_that_is_trained_on_is_an_error(stage, tmp_path):
    log = stage.log.copy()
    log[13] = 1.5 * log[20]  # frame 13 holds its pattern out, 20 trains

    def brighten(images: pd.DataFrame) -> pd.DataFrame:
        images.loc[images.frame == 13, "path"] = images.path[images.frame == 20].to_numpy()
        return images

    index = stage.index(tmp_path / "index", log, images=brighten)
    with pytest.raises(InputError, match=r"frame 13: expected light that no training frame[\s\S]*training frame 20"):
        book(stage, tmp_path / "out", index, on_desync="ignore")
    frames, _, _ = book(stage, tmp_path / "out", index, on_desync="ignore", on_leak="warn")
    assert len(frames) == FRAMES


def test_missing_calibration_is_named_before_any_image_is_read(stage, tmp_path):
    pd.read_parquet(stage.root / "lights.parquet")[:14].to_parquet(tmp_path / "lights.parquet")
    write_cameras(tmp_path / "cameras.json", {f"c{i}": camera_at(stage.figure.cameras[i]) for i in range(4)})
    with pytest.raises(InputError, match=r"3 problems[\s\S]*L014[\s\S]*L015[\s\S]*c4"):
        run(
            capture=tmp_path / "nowhere",
            index=stage.root / "index",
            lights=tmp_path / "lights.parquet",
            cameras=tmp_path / "cameras.json",
            out=tmp_path,
        )
