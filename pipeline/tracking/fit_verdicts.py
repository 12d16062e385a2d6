"""Verdicts on a tracked chunk as a whole: does the template follow the person at all?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import Complaints, listed
from pipeline.base.verdicts import Verdict

HARDLY_ANY = 0.5
"""Share of detected keypoints near the template's below which a tracking is failed: detectors are wrong at one in
twenty; where half are, it is the table that is."""

NO_OVERLAP = 0.7
"""Intersection over union of silhouettes below which a tracking is failed. Of two silhouettes of one size, 18 % of each
are elsewhere then (1 - 2 x 0.7 / 1.7): more than hair and cloth that no template has (a few percent) and a limb that is
off (ten) together. Inverted masks have 0.01, white ones 0.15, another camera's hardly half."""


def fit_verdicts(
    inliers: int, observations: int, overlaps: Mapping[str, Float64[np.ndarray, " frames"]]
) -> list[Verdict]:
    """One verdict on the keypoints, and one on the masks of each camera.

    Args:
        inliers: detected keypoints that are near the template's.
        observations: all detected keypoints.
        overlaps: camera -> intersection over union of its masks and the template's silhouettes; NaN without a mask.
    """
    share = inliers / max(observations, 1)
    said = f"{share:.0%} of {observations} detections are near the template's"
    advice = "; are x and y exchanged, left and right, or the names of cameras?"
    few = share < HARDLY_ANY
    verdicts = [Verdict("keypoints", "all", "failed" if few else "good", said + advice if few else said)]
    for camera, values in overlaps.items():
        if np.isfinite(values).any():
            median = float(np.nanmedian(values))
            grade = "failed" if median < NO_OVERLAP else "good"
            verdicts.append(Verdict("masks", camera, grade, f"silhouettes overlap by {median:.3f} (median)"))
    return verdicts


def complain_of_misfits(verdicts: Sequence[Verdict], expected_from: object) -> None:
    """End the run if a verdict is failed.

    Args:
        verdicts: of `fit_verdicts`.
        expected_from: what the complaints are about.

    Raises:
        InputError: naming the keypoints, or the cameras whose masks show something else, with their numbers.
    """
    complaints = Complaints(expected_from)
    for verdict in verdicts:
        if verdict.kind == "keypoints" and verdict.grade == "failed":
            expected = f"at least {HARDLY_ANY:.0%} of the detections near the tracked template"
            complaints.add("keypoints_2d", "x, y", expected=expected, found=verdict.reason)
    masks = [verdict for verdict in verdicts if verdict.kind == "masks"]
    if failed := [verdict for verdict in masks if verdict.grade == "failed"]:
        every = len(failed) == len(masks)
        hint = (
            "is the subject 255 and all else 0? do the keypoints fit the images?"
            if every
            else "are these cameras' images and masks exchanged with others'?"
        )
        complaints.add(
            "masks", "all cameras" if every else listed([verdict.name for verdict in failed]),
            expected=f"masks that overlap the tracked template by {NO_OVERLAP:g} or more",
            found=listed([f"{verdict.name}: {verdict.reason}" for verdict in failed]),
            hint=f"{hint} `track_mesh: {{on_misfit: warn}}` goes on all the same",
        )  # fmt: skip
    complaints.raise_if_any()
