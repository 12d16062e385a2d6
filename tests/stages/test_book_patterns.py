"""The bookkeeping stage on a planted stage: a grey disc of known brightness under a log that may be out of step."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.book_patterns import run
from pipeline.capture.images import write_exr, write_png
from pipeline.config.book_patterns import BookPatterns
from pipeline.geometry.cameras import Camera, write_cameras

FRAMES, SIZE = 30, 12
LIGHTS = pd.DataFrame({"light": ["A", "B", "C"], "x": [2.0, -2.0, 0.0], "y": [0.0, 1.0, 2.5], "z": [0.0, 1.0, 0.0]})


def look_at_origin(angle: float) -> Camera:
    c, s = np.cos(angle), np.sin(angle)
    K = np.array([[40.0, 0, SIZE / 2], [0, 40.0, SIZE / 2], [0, 0, 1]])
    return Camera(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.array([0.0, 0, 3]), K, np.zeros(5), SIZE, SIZE)


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Path:
    """A capture whose log is right: brightness of the disc = sum of I / d^2 at the origin, times each camera's gain."""
    root = tmp_path_factory.mktemp("stage")
    rng = np.random.default_rng(1)
    logged = [(f, light, i) for f in range(FRAMES) for light, i in zip("ABC", rng.uniform(0, 3, 3), strict=True)
              if f % 5 == 0 or rng.uniform() < 0.5]  # fmt: skip
    patterns = pd.DataFrame(logged, columns=["frame", "light", "intensity"])
    inverse = dict(zip(LIGHTS.light, 1 / (LIGHTS[["x", "y", "z"]] ** 2).sum(axis=1), strict=True))
    brightness = (patterns.intensity * patterns.light.map(inverse)).groupby(patterns.frame).sum()
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
    disc = (x - SIZE / 2) ** 2 + (y - SIZE / 2) ** 2 < 9
    rows = []
    for camera, gain in (("c0", 1.0), ("c1", 0.3)):
        write_png(root / f"masks/{camera}.png", disc.astype(np.uint8) * 255)
        for frame in range(FRAMES):
            shown = gain * 0.1 * brightness.get(frame, 0.0) * (1 + 0.03 * rng.normal())
            write_exr(root / f"{camera}/{frame}.exr", np.where(disc[..., None], shown, 0.9).repeat(3, 2) + 0.05)
            flags = {"test_camera": False, "test_frame": frame == 7, "test_segment": frame >= 27}
            files = {"path": f"{camera}/{frame}.exr", "mask_path": f"masks/{camera}.png"}
            rows.append({"camera": camera, "frame": frame, **files, **flags})
    (root / "index").mkdir()
    pd.DataFrame(rows).to_parquet(root / "index/images.parquet")
    patterns.to_parquet(root / "index/patterns.parquet")
    frames = pd.DataFrame({"frame": range(FRAMES), "timestamp_s": np.arange(FRAMES) / 24, "segment": "a"})
    frames.to_parquet(root / "index/frames.parquet")
    facts = {"images": {"transfer": "linear", "black_level": 0.05, "downsample_from_sensor": 1}}
    (root / "index/capture.json").write_text(json.dumps(facts))
    LIGHTS.to_parquet(root / "lights.parquet")
    write_cameras(root / "cameras.json", {"c0": look_at_origin(0.0), "c1": look_at_origin(1.2)})
    return root


def book(stage: Path, out: Path, index: Path | None = None, **settings) -> tuple[pd.DataFrame, pd.DataFrame, dict]:
    run(
        capture=stage,
        index=index or stage / "index",
        lights=stage / "lights.parquet",
        cameras=stage / "cameras.json",
        out=out,
        settings=BookPatterns(**settings),
    )
    sync = json.loads((out / "sync.json").read_text())
    return pd.read_parquet(out / "frames.parquet"), pd.read_parquet(out / "patterns.parquet"), sync


def shifted_index(stage: Path, tmp_path: Path, offset: int) -> Path:
    index = tmp_path / "index"
    index.mkdir()
    for name in ("images.parquet", "frames.parquet", "capture.json"):
        (index / name).write_bytes((stage / "index" / name).read_bytes())
    patterns = pd.read_parquet(stage / "index/patterns.parquet")
    patterns = patterns.assign(frame=patterns.frame + offset)
    patterns[patterns.frame.between(0, FRAMES - 1)].to_parquet(index / "patterns.parquet")
    return index


def test_a_stage_in_sync(stage, tmp_path):
    frames, patterns, sync = book(stage, tmp_path)
    assert (sync["offset_frames"], sync["verdict"]) == (0, "in_sync")
    assert sync["correlation"] > 0.9
    np.testing.assert_allclose(sync["subject_center_m"], 0, atol=1e-6)  # both discs are centred on the axes
    assert frames.columns.tolist() == [
        "frame", "timestamp_s", "segment", "lights_on", "fully_lit", "split", "predicted", "observed", "suspicious",
    ]  # fmt: skip
    assert frames.fully_lit[::5].all()
    assert frames.lights_on.max() == 3
    assert frames.split.value_counts().to_dict() == {"train": 26, "test_segments": 3, "test_frames": 1}
    lit = frames[frames.lights_on > 0]
    assert (lit.observed / lit.predicted).std() < 0.1 * (lit.observed / lit.predicted).mean()  # gain, mask, black level
    assert not frames.suspicious.any()
    assert patterns.columns.tolist() == [
        "frame", "light", "intensity_r", "intensity_g", "intensity_b", "fully_lit", "split",
    ]  # fmt: skip
    assert (tmp_path / "sync.png").read_bytes()[:4] == b"\x89PNG"


def test_a_fault_is_an_error_that_says_how_to_mend_it(stage, tmp_path):
    index = shifted_index(stage, tmp_path, 3)
    with pytest.raises(InputError, match=r"\+3 frames away.*subtract 3.*on_desync"):
        book(stage, tmp_path / "out", index)
    assert (tmp_path / "out/sync.png").exists()
    assert not (tmp_path / "out/patterns.parquet").exists()


@pytest.mark.parametrize("offset", [-4, 1])
def test_a_fault_is_fixed(stage, tmp_path, offset):
    right, right_patterns, _ = book(stage, tmp_path / "right")
    frames, patterns, sync = book(stage, tmp_path / "out", shifted_index(stage, tmp_path, offset), on_desync="fix")
    assert (sync["offset_frames"], sync["applied_offset_frames"], sync["verdict"]) == (offset, offset, "out_of_sync")
    assert len(frames) == FRAMES - abs(offset)
    kept = right[right.frame.isin(frames.frame)].reset_index(drop=True)
    # Numbers after the fix are those of the images: everything is as if the log had been right.
    pd.testing.assert_frame_equal(frames.drop(columns="suspicious"), kept.drop(columns="suspicious"))
    expected = right_patterns[right_patterns.frame.isin(frames.frame)].reset_index(drop=True)
    pd.testing.assert_frame_equal(patterns, expected)


def test_a_fault_is_ignored_on_demand(stage, tmp_path):
    frames, _, sync = book(stage, tmp_path / "out", shifted_index(stage, tmp_path, 2), on_desync="ignore")
    assert (sync["offset_frames"], sync["applied_offset_frames"]) == (2, 0)
    assert len(frames) == FRAMES


def test_missing_calibration_is_named_before_any_image_is_read(stage, tmp_path):
    LIGHTS[:1].to_parquet(tmp_path / "lights.parquet")
    write_cameras(tmp_path / "cameras.json", {"c0": look_at_origin(0.0)})
    with pytest.raises(InputError, match=r"3 problems[\s\S]*B[\s\S]*C[\s\S]*c1"):
        run(
            capture=tmp_path / "nowhere",
            index=stage / "index",
            lights=tmp_path / "lights.parquet",
            cameras=tmp_path / "cameras.json",
            out=tmp_path,
        )
