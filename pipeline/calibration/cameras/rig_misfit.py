"""Reports of views that do not fit a rig that stands still, and what to do about them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.base.errors import Complaints, listed
from pipeline.calibration.cameras.rig_calibration import Inspection, Movement

KNOCK_M, KNOCK_DEG = 1.0, 45.0
"""A camera found to have gone farther was not knocked: it would see another room. Its views are those of two cameras,
or joined wrongly; which of them, the views do not tell."""

MOST_GROSS_OUTLIERS = 0.25
"""Share of a camera's views that may be far off: a robust adjustment leaves out a few bad ones, but where they are many
it is open which of them are right."""

MIXED = "look for images of another camera or shot, and for boards that moved between the images of a shot"
"""What most often keeps views from fitting together."""


def complain_of_misfits(
    inspection: Inspection,
    names: Sequence[str],
    views: Sequence[int],
    largest_shift_px: float,
    section: str,
    complaints: Complaints,
) -> None:
    """Complain of cameras that moved and of views that fit nowhere.

    A movement counts above `largest_shift_px`.

    Args:
        names: of the cameras.
        views: number of each camera's views.
        section: of capture.yaml, that the complaints name.
    """
    for movement in inspection.movements:
        if movement.shift_px > largest_shift_px:
            hint = f"remove or record again the views before {movement.shot}, or those from it on"
            hint += "; a lens that was refocused looks the same"
            expected = "cameras that stand still"
            if not is_knock(movement):
                expected, hint = "views that fit together", f"{MIXED}; or {hint}"
            told = describe_movement(movement, [names[suspect] for suspect in movement.suspects])
            complaints.add(section, "views", expected=expected, found=told, hint=hint)
    for camera, told in too_many_gross_outliers(inspection, views).items():
        hint = f"{MIXED}; or remove these views"
        complaints.add(section, f"camera {names[camera]}", expected="views that fit together", found=told, hint=hint)


def too_many_gross_outliers(inspection: Inspection, views: Sequence[int]) -> dict[int, str]:
    """Cameras with so many outlying views that the rig cannot be trusted, and which views.

    Outlying views fit none of a camera's poses.

    Args:
        views: number of each camera's views.
    """
    told = {}
    for camera, shots in inspection.gross_outliers.items():
        if len(shots) > MOST_GROSS_OUTLIERS * views[camera]:
            told[camera] = f"{len(shots)} of {views[camera]} views could not be brought together: {listed(shots)}"
    return told


def is_knock(movement: Movement) -> bool:
    """True for a movement that a camera may suffer where it stands.

    So is one too short-lived to measure.
    """
    return not (movement.shift_m > KNOCK_M or movement.turn_deg > KNOCK_DEG)


def describe_movement(movement: Movement, suspects: Sequence[str]) -> str:
    """Name the camera that moved, when and how far; or say that its views do not fit together."""
    which = " or ".join(suspects)
    moved = "" if np.isnan(movement.shift_m) else f", {1000 * movement.shift_m:.1f} mm and {movement.turn_deg:.2f} deg"
    size = f"{movement.shift_px:.2g} px{moved}"
    if is_knock(movement):
        return f"{which} moved before view {movement.shot} ({size})"
    return f"the views of {which} before and from {movement.shot} on could not be brought together ({size} apart)"
