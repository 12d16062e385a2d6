"""Sound and broken recordings of boards, for the verdicts on cameras."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from benchmarks.verdict import Judged
from pipeline.calibration.cameras.rig_calibration import calibrate_rig, inspect_rig
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_quality import judge_cameras, quality_table, rough_shots
from pipeline.calibration.cameras.rig_spread import with_spread
from pipeline.config.calibrate_cameras import CalibrateCameras
from tests.support.rigs.cameras import BOARD, SIZE, boards_in_stage, observe, planted_cameras, without_small_views

CAMERAS, VIEWS = 3, 16
KNOCKED, MIXED, FLAT = "camera knocked by 1 cm and 1 degree", "two views exchanged", "board always square to a camera"


def camera_alarm(fault: str | None, seed: int, size: float = 0.01) -> bool:
    """Three cameras around a board with corners good to 0.1 px; camera 1 is the one that is broken.

    A knock moves it by `size`, metres, and turns it by a degree per centimetre.
    """
    rng = np.random.default_rng(seed)
    cameras, boards = planted_cameras(CAMERAS, rng, arc=1.2), boards_in_stage(VIEWS, rng, arc=1.2)
    if fault == FLAT:
        cameras = cameras[:1]
        facing = np.diag([1.0, -1.0, -1.0]) @ cameras[0].R
        for pose in boards:
            pose[:3, :3] = facing.T
            pose[:3, 3] = rng.uniform(-0.2, 0.2, 3) - pose[:3, :3] @ [0.42, 0.3, 0]
    seen = observe(cameras, boards, 0.1, rng)
    if fault == KNOCKED:
        old = cameras[1]
        R = cv2.Rodrigues(np.radians([0.0, 100 * size, 0.0]))[0] @ old.R
        moved = [*cameras]
        moved[1] = replace(old, R=R, t=-R @ (old.center + size * old.R[0]))
        late = observe(moved, boards, 0.1, rng)
        parts = (seen.select(seen.view < VIEWS // 2), late.select(late.view >= VIEWS // 2))
        seen = Observations(*(np.concatenate([getattr(p, k) for p in parts]) for k in seen_fields()))
    if fault == MIXED:
        mine = (seen.camera == 1) & (seen.view < 2)
        seen = replace(seen, view=np.where(mine, 1 - seen.view, seen.view))
    chosen, shots = without_small_views(seen)
    names, sizes = [f"cam{c}" for c in range(len(cameras))], [SIZE] * len(cameras)
    settings = CalibrateCameras(good_center_m=0.02)  # For few views of so small a board.
    try:
        calibrated = with_spread(calibrate_rig(chosen, BOARD.corners_m(), sizes, 5), shots)
        inspection = inspect_rig(calibrated, BOARD.corners_m(), sizes, shots)
    except (ValueError, np.linalg.LinAlgError):
        return True  # Refused: nothing is judged good.
    rough = rough_shots(calibrated.rig, names, shots, settings.good_rms_px)
    quality = quality_table(calibrated, names, shots)
    verdicts = judge_cameras(quality, calibrated, rough, inspection, names, settings)
    broken = names if fault is None else names[-1:] if fault == FLAT else ["cam1"]
    return any(verdict.grade != "good" for verdict in verdicts if verdict.name in broken)


def seen_fields() -> tuple[str, ...]:
    """Columns of observations of boards that stand still."""
    return ("camera", "view", "corner", "pixel")


CAMERA = Judged("rig_quality.judge_cameras", (KNOCKED, MIXED, FLAT), camera_alarm)
