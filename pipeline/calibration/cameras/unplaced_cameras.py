"""Complaints about cameras that features do not place, with what their matches lack."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pycolmap

from pipeline.base.errors import Complaints
from pipeline.calibration.cameras.feature_matches import PairMatches

LEAST_MATCHES = pycolmap.IncrementalMapperOptions().abs_pose_min_num_inliers
"""Known points that place a further camera: COLMAP's own number."""

FEW = "cameras 20 degrees apart and less, a textured subject that fills depth, larger images; or calibrate with boards"

MANY = (
    "its neighbours' rays may be too nearly parallel, three cameras may share too few points, or a lens that was given "
    "may be another's; cameras in between, other lenses, or boards"
)


def complain_of_unplaced(
    capture: Path, cameras: Sequence[str], placed: Sequence[str], matches: Sequence[PairMatches]
) -> None:
    """Refuse a rig of which cameras are not placed.

    Raises:
        InputError: naming each of them, with the features that it shares with the others.
    """
    complaints = Complaints(capture)
    for name in cameras:
        if name not in placed:
            own = [pair for pair in matches if name in (pair.first, pair.second)]
            expected = f"{LEAST_MATCHES} points of the subject and more that other cameras see, too, in depth"
            where = f"camera {name}"
            complaints.add("calibration.cameras", where, expected=expected, found=_told(name, own), hint=_hint(own))
    complaints.raise_if_any()


def _told(name: str, own: Sequence[PairMatches]) -> str:
    """Counts by other camera, the largest first."""
    ranked = sorted(own, key=lambda pair: (-pair.verified, -pair.found))
    parts = []
    for pair in [pair for pair in ranked if pair.found][:3]:
        other = pair.second if pair.first == name else pair.first
        plane = ", on one plane or from one place" if pair.flat else ""
        parts.append(f"{pair.verified} that fit one pose with {other}{plane} (of {pair.found} alike)")
    return "; ".join(parts) or "none that is alike in another camera"


def _hint(own: Sequence[PairMatches]) -> str:
    return MANY if any(pair.verified >= LEAST_MATCHES and not pair.flat for pair in own) else FEW
