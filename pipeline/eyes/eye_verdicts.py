"""Verdicts on fitted eyes, and on the gaze that the capture declares for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import listed
from pipeline.base.verdicts import Grade, Verdict
from pipeline.eyes.eye_fit import FOLLOWING_DEG, LEAST_BULGE_M, FittedEye
from pipeline.eyes.gaze_estimate import GazeEstimate

SURE = 5.0
"""Sigmas, sqrt(2 log-likelihood ratio), by which another reading of the gaze has to be ahead: of two simple hypotheses
the false one is so far ahead with a probability of 3e-7."""

FALSE_ALARMS = 1e-3
"""Probability that any frame of a sound capture is called odd, shared out over the frames."""

MEDIAN_ANGLE = float(np.sqrt(2 * np.log(2)))
"""Median of the angle between directions that are off by 1 in each of two ways (Rayleigh's distribution)."""

LEAST_NOISE_DEG = 0.02
"""Noise of a direction: two digits after the point of an angle in degrees, and float32 in the vertices."""

HEAD_M = 0.1
"""Distance from an eye within which the template is head: half of one."""

STILL = "it did not turn"

READINGS = {
    STILL: (0.0, 0.0),
    "left and right were exchanged": (-1.0, 1.0),
    "up and down were exchanged": (1.0, -1.0),
    "it turned the other way": (-1.0, -1.0),
}
"""Ways in which tracked eyes and a table of gaze disagree: factors on what the table says to the side and up."""


def eye_verdict(name: str, eye: FittedEye, rest: Float64[np.ndarray, "vertices 3"]) -> Verdict:
    """Judge the spheres, and which way they look.

    Weak if vertices are as far from the spheres as a cornea stands out; failed if the eye looks into the head.

    Args:
        rest: all vertices of the template at rest, metres.
    """
    others = np.delete(rest, list(eye.vertices), axis=0)
    near = others[np.linalg.norm(others - eye.center, axis=1) < HEAD_M]
    inward = float((near - eye.center).mean(0) @ eye.axis) if len(near) else -1.0
    said = f"radius {1e3 * eye.shape.radius_m:.2f} mm, {eye.status}, vertices within {1e3 * eye.rms_m:.3f} mm (rms)"
    if inward > 0:
        return Verdict("eye", name, "failed", f"{said}: it looks into the head; does the gaze point out of the eye?")
    if eye.rms_m > LEAST_BULGE_M:
        return Verdict("eye", name, "weak", f"{said}: is that an eyeball, and all of it? see template.eyes")
    return Verdict("eye", name, "good", said)


def gaze_verdict(
    name: str, frames: list[int], tracked: Float64[np.ndarray, "frames 3"], gaze: Float64[np.ndarray, "frames 3"]
) -> Verdict:
    """Judge whether the tracked eye turns as the gaze does.

    Failed if it clearly turns as with a table that was written wrongly (`READINGS`); weak if it does not turn though
    the gaze does, if it is off by more than `FOLLOWING_DEG`, or in single frames.

    Args:
        name: of the eye.
        frames: their numbers.
        tracked: unit direction of the tracked eye's axis in the head's frame.
        gaze: unit direction that the capture declares.
    """
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(tracked, gaze), axis=1), (tracked * gaze).sum(1)))
    rms = float(np.sqrt(np.mean(angle**2)))
    said = f"the tracked eye is {rms:.2f} degrees (rms) off"
    turned, looks = _to_the_side_and_up(tracked, gaze)
    fit = _spread(turned - looks)
    readings = {reading: _ahead(turned - looks * factors, fit) for reading, factors in READINGS.items()}
    best = max(readings, key=lambda reading: readings[reading])
    if readings[best] > SURE:
        grade: Grade = "weak" if best == STILL else "failed"
        found = f"{said}, and turns as if {best} ({readings[best]:.0f} sigma): see the gaze table"
        return Verdict("gaze", name, grade, found)
    if rms > FOLLOWING_DEG:
        return Verdict("gaze", name, "weak", f"{said}: it does not follow the gaze")
    usual = max(float(np.median(angle)) / MEDIAN_ANGLE, LEAST_NOISE_DEG)
    most = usual * np.sqrt(2 * np.log(len(angle) / FALSE_ALARMS))
    if len(odd := np.flatnonzero(angle > most)):
        numbers = listed([str(frames[row]) for row in odd])
        found = f"{said}, up to {angle.max():.1f} in frames {numbers}: wrong there, or looking elsewhere?"
        return Verdict("gaze", name, "weak", found)
    return Verdict("gaze", name, "good", said)


def estimate_verdict(name: str, frames: list[int], estimates: Sequence[GazeEstimate]) -> Verdict:
    """Judge the estimates of one eye's gaze in fully lit frames.

    Failed if there is none; weak if the gaze is undefined in some frame, or pictures agree on it to less than
    `FOLLOWING_DEG`.
    """
    sigmas = [estimate.sigma_deg for estimate in estimates if estimate.status == "estimated"]
    undefined = {
        why: [str(frame) for frame, estimate in zip(frames, estimates, strict=True) if estimate.status == status]
        for status, why in (("hidden", "lids hide the eye"), ("unclear", "no iris shows"))
    }
    said = [
        f"undefined in {len(numbers)} frames, as {why}: {listed(numbers)}"
        for why, numbers in undefined.items()
        if numbers
    ]
    if not sigmas:
        reason = "; ".join(said) if said else "no fully lit frame"
        return Verdict("gaze", name, "failed", f"not estimated: {reason}; declare gaze, or eyes look as tracked")
    spread = float(np.sqrt(np.mean(np.square(sigmas))))
    known = f"estimated in {len(sigmas)} of {len(frames)} fully lit frames, pictures agree to {spread:.1f} degrees"
    grade: Grade = "weak" if said or spread > FOLLOWING_DEG else "good"
    return Verdict("gaze", name, grade, "; ".join([known, *said]))


def _to_the_side_and_up(
    tracked: np.ndarray, gaze: np.ndarray
) -> tuple[Float64[np.ndarray, "frames 2"], Float64[np.ndarray, "frames 2"]]:
    """Both directions as tangents to the side and up, y, without their means, degrees."""
    ahead = gaze.mean(0)
    ahead = ahead / np.linalg.norm(ahead)
    side = np.cross([0.0, 1.0, 0.0], ahead)
    # Gaze along y has no side; any will do.
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-6 else np.array([1.0, 0.0, 0.0])
    across = np.stack([side, np.cross(ahead, side)])
    turned, looks = (np.degrees(np.arctan2(d @ across.T, (d @ ahead)[:, None])) for d in (tracked, gaze))
    return turned - turned.mean(0), looks - looks.mean(0)


def _spread(difference: np.ndarray) -> float:
    """Variance of one component, degrees^2, with that of a table's digits."""
    return float(np.mean(difference**2)) + LEAST_NOISE_DEG**2


def _ahead(difference: np.ndarray, fit: float) -> float:
    """Sigmas by which normal differences of a variance of their own are likelier than those of variance `fit`.

    The log-likelihood ratio of n normal numbers of either variance is n / 2 log(fit / theirs); 0 if they are less
    likely.
    """
    return float(np.sqrt(max(difference.size * np.log(fit / _spread(difference)), 0.0)))
