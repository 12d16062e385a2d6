"""Sound and broken tables of gaze, for the verdict on gaze; and surveys beside measured lights."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.verdict import Judged
from pipeline.calibration.lights.survey_verdict import survey_verdict
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.eyes.eye_verdicts import gaze_verdict
from pipeline.geometry.rigid_alignment import align_rigid

LOOKS_DEG, TRACKED_DEG = (8.0, 5.0), 1.0
"""Standard deviations of a gaze to the side and up, and of a tracked eye: 0.2 mm at its rim."""

SIDES, HEIGHTS, STILL, LATE, SOME = (
    "left and right exchanged", "up and down exchanged", "eyes do not turn", "gaze of the next frame",
    "three frames look elsewhere",
)  # fmt: skip


def gaze_alarm(fault: str | None, seed: int, size: float | None = None) -> bool:
    """Gaze and tracked eye in 12 to 64 frames; frames that look elsewhere do so by 15 degrees, or as asked."""
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(12, 65))
    angles = rng.normal(0, LOOKS_DEG, (frames, 2))
    turns = 0 * angles if fault == STILL else angles
    tracked = _directions(turns + rng.normal(0, TRACKED_DEG, (frames, 2)))
    if fault == SOME:
        angles[rng.choice(frames, 3, replace=False), 0] += 15.0 if size is None else size
    gaze = _directions(angles + rng.normal(0, 0.3, (frames, 2)))
    gaze = gaze * {SIDES: [-1, 1, 1], HEIGHTS: [1, -1, 1]}.get(fault, [1, 1, 1])
    gaze = np.roll(gaze, 1, axis=0) if fault == LATE else gaze
    return gaze_verdict("eye", list(range(frames)), tracked, gaze).grade != "good"


def _directions(angles: np.ndarray) -> np.ndarray:
    return Rotation.from_euler("YX", angles, degrees=True).apply([0.0, 0.0, 1.0])


LARGER, TURNED, SHIFTED = "survey 2 % larger", "survey turned by 2 degrees", "survey shifted by 5 cm"


def survey_alarm(fault: str | None, seed: int, size: float | None = None) -> bool:
    """Twenty lights measured to 2 mm and surveyed to 1 cm, cameras known in the survey's frame."""
    rng = np.random.default_rng(seed)
    lights = rng.normal(size=(20, 3))
    lights *= 2.4 / np.linalg.norm(lights, axis=1, keepdims=True)
    surveyed = lights + rng.normal(0, 0.01, lights.shape)
    if fault == LARGER:
        surveyed = surveyed * (1.02 if size is None else 1 + size)
    if fault == TURNED:
        axis = rng.normal(size=3)
        turn = axis / np.linalg.norm(axis) * np.radians(2.0 if size is None else size)
        surveyed = Rotation.from_rotvec(turn).apply(surveyed)
    if fault == SHIFTED:
        surveyed = surveyed + np.array([0.05 if size is None else size, 0, 0])
    measured = lights + rng.normal(0, 0.002, lights.shape)
    alignment = align_rigid(measured, surveyed)
    return survey_verdict(measured, surveyed, alignment, True, CalibrateLights()).grade != "good"


GAZE = Judged("eye_verdicts.gaze_verdict", (SIDES, HEIGHTS, STILL, LATE, SOME), gaze_alarm)
SURVEY = Judged("survey_verdict.survey_verdict", (LARGER, TURNED, SHIFTED), survey_alarm)
