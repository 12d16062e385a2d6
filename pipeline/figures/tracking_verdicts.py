"""Verdicts on a tracking: frames and cameras that need a look, with the reason."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from pipeline.base.verdicts import Grade, Verdict
from pipeline.figures.tracked_capture import TrackedCapture
from pipeline.tracking.fit_verdicts import HARDLY_ANY, NO_OVERLAP

FEW_INLIERS = 0.8
"""Share of detected keypoints near the template's, below which a frame is weak; failed below `HARDLY_ANY`.

Detectors are wrong at one in twenty; at half, the pose is.
"""

LOW_OVERLAP = 0.9
"""Overlap of silhouettes below which a frame is weak; failed below `NO_OVERLAP`.

Hair and cloth that no template has take a few percent; a limb that is off takes ten.
"""

ODD = 6.0
"""Robust standard deviations from the median beyond which a frame is not like the others."""

ODD_ERROR_SHARE, ODD_OVERLAP, ODD_JUMP_M = 0.3, 0.02, 0.01
"""Differences from the median that nobody minds.

Of the keypoints' error, over the median; of overlaps; of jumps, metres.
"""

CAMERA_OFF, CAMERA_LOST = 2.0, 5.0
"""Median error of a camera's keypoints over that of all cameras: weak, and failed.

Beyond the first, the camera was knocked or is calibrated badly; beyond the second, the calibration is another stage's.
"""

ELSEWHERE = ("given", "between", "held")
"""Statuses of frames whose meshes were tracked elsewhere: keypoints, if there are any, moved nothing."""

Reasons = list[tuple[Grade, str]]


def jumps_m(found: TrackedCapture) -> Float64[np.ndarray, " frames"]:
    """Mean distance of vertices from the middle between the frames before and after, metres.

    NaN at a segment's ends. For the motion x(t) it is x'' dt^2 / 2: a tracking that slips for a frame has it, and a
    body hardly does.
    """
    middle = np.full(len(found.frames), np.nan)
    segment = found.frames.segment.to_numpy()
    for f in range(1, len(middle) - 1):
        if segment[f - 1] == segment[f] == segment[f + 1]:
            before, here, after = found.vertices[f - 1 : f + 2].astype(np.float64)
            middle[f] = np.linalg.norm(here - (before + after) / 2, axis=1).mean()
    return middle


def frame_verdicts(found: TrackedCapture) -> list[Verdict]:
    """One verdict per frame."""
    frames, jumps = found.frames, jumps_m(found)
    errors, overlaps = (frames[name].to_numpy(np.float64) for name in ("rms_px", "silhouette_iou"))
    high_error = _usual(errors, ODD_ERROR_SHARE * _median(errors))[1]
    low_overlap, high_jump = _usual(overlaps, ODD_OVERLAP)[0], _usual(jumps, ODD_JUMP_M)[1]
    # Frames beside one that slipped are off the middle, too: by half as much.
    around = np.pad(np.nan_to_num(jumps), 1)
    jumped = (jumps > high_jump) & (jumps >= around[:-2]) & (jumps >= around[2:])
    verdicts = []
    for row, error, overlap, jump, is_jump in zip(frames.itertuples(), errors, overlaps, jumps, jumped, strict=True):
        numbers = f"{row.status}, {error:.2f} px, {row.inliers} of {row.observations} keypoints fit"
        if row.status in ELSEWHERE:
            seen = f", {error:.2f} px, {row.inliers} of {row.observations} keypoints fit" if row.observations else ""
            numbers = f"tracked elsewhere, {row.status}{seen}"
        numbers += f", silhouettes overlap {overlap:.3f}" if np.isfinite(overlap) else ""
        reasons = _keypoint_reasons(row.status, row.inliers / max(row.observations, 1))
        reasons += _overlap_reasons(overlap, low_overlap)
        if error > high_error:
            reasons.append(("weak", f"keypoints fit worse than in other frames ({_median(errors):.2f} px)"))
        if is_jump:
            odd = f"jumps by {1e3 * jump:.0f} mm (other frames: {1e3 * _median(jumps):.0f} mm)"
            reasons.append(("weak", f"{odd}: slipped, or frames are missing"))
        grade: Grade = min((grade for grade, _ in reasons), key=("failed", "weak").index, default="good")
        reason = "; ".join([*(text for _, text in reasons), numbers])
        verdicts.append(Verdict("frame", str(row.frame), grade, reason))
    return verdicts


def _keypoint_reasons(status: str, share: float) -> Reasons:
    if status in ELSEWHERE:
        advice = "the mesh beside it stands in: leave it out, or give a mesh"
        return [("weak", f"no mesh on one side, {advice}")] if status == "held" else []
    if status == "interpolated":
        return [("failed", "too few keypoints, so it was interpolated: leave it out, or detect its keypoints again")]
    if share < FEW_INLIERS:
        text = f"only {share:.0%} of the keypoints fit: are they on the right person, left and right not exchanged?"
        return [("failed" if share < HARDLY_ANY else "weak", text)]
    return []


def _overlap_reasons(overlap: float, low: float) -> Reasons:
    if overlap < LOW_OVERLAP:
        return [("failed" if overlap < NO_OVERLAP else "weak", "silhouettes do not overlap: masks or pose are wrong")]
    if overlap < low:
        return [("weak", "silhouettes overlap less than in other frames")]
    return []


def camera_verdicts(found: TrackedCapture) -> list[Verdict]:
    """One verdict per camera that has keypoints: whether they are where the tracked template is."""
    medians = {
        name: float(np.nanmedian(residual))
        for name, residual in zip(found.cameras, found.residual_px, strict=True)
        if np.isfinite(residual).any()
    }
    usual = _median(np.array(list(medians.values())))
    verdicts = []
    for name, median in medians.items():
        ratio = median / usual if usual > 0 else 1.0
        grade: Grade = "failed" if ratio > CAMERA_LOST else "weak" if ratio > CAMERA_OFF else "good"
        advice = "" if grade == "good" else f", {ratio:.1f} times the usual: was it moved since it was calibrated?"
        role = "held out, " if name in found.held_out else ""
        verdicts.append(Verdict("camera", name, grade, f"{role}keypoints fit to {median:.2f} px (median){advice}"))
    return verdicts


def _median(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else float("nan")


def _usual(values: np.ndarray, least: float) -> tuple[float, float]:
    """Range round the median of frames that are like the others.

    `ODD` robust deviations, `least` at least.
    """
    middle = _median(values)
    spread = max(ODD * 1.4826 * _median(np.abs(values - middle)), least)  # 1.4826: MAD to standard deviation
    return middle - spread, middle + spread
