"""What does not fit a rig that stands still: what to say of it, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.base.errors import Complaints, listed
from pipeline.calibration.cameras.rig_calibration import Inspection, Movement

KNOCK_M, KNOCK_DEG = 1.0, 45.0
"""A camera found to have gone farther was not knocked: it would see another room. Its views are those of two cameras,
or joined wrongly; which of them, the views do not tell."""

MOST_ASTRAY = 0.25
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
    """Complaints on cameras that moved by more than `largest_shift_px`, and on views that fit nowhere.

    Args:
        names: of the cameras.
        views: number of each camera's views.
        section: of capture.yaml, that the complaints name.
    """
    for movement in inspection.movements:
        if movement.shift_px > largest_shift_px:
            hint = f"remove or record again the views before {movement.shot}, or those from it on"
            expected = "cameras that stand still"
            if not is_knock(movement):
                expected, hint = "views that fit together", f"{MIXED}; or {hint}"
            told = describe_movement(movement, [names[suspect] for suspect in movement.suspects])
            complaints.add(section, "views", expected=expected, found=told, hint=hint)
    for camera, told in too_many_astray(inspection, views).items():
        hint = f"{MIXED}; or remove these views"
        complaints.add(section, f"camera {names[camera]}", expected="views that fit together", found=told, hint=hint)


def too_many_astray(inspection: Inspection, views: Sequence[int]) -> dict[int, str]:
    """Cameras of which so many views fit none of their poses that the rig cannot be trusted, and which views.

    Args:
        views: number of each camera's views.
    """
    told = {}
    for camera, shots in inspection.astray.items():
        if len(shots) > MOST_ASTRAY * views[camera]:
            told[camera] = f"{len(shots)} of {views[camera]} views could not be brought together: {listed(shots)}"
    return told


def is_knock(movement: Movement) -> bool:
    """Whether a movement is one that a camera may suffer where it stands; so is one too short-lived to measure."""
    return not (movement.shift_m > KNOCK_M or movement.turn_deg > KNOCK_DEG)


def describe_movement(movement: Movement, suspects: Sequence[str]) -> str:
    """Which camera moved, when and how far; or that its views do not fit together at all."""
    which = " or ".join(suspects)
    moved = "" if np.isnan(movement.shift_m) else f", {1000 * movement.shift_m:.1f} mm and {movement.turn_deg:.2f} deg"
    size = f"{movement.shift_px:.2g} px{moved}"
    if is_knock(movement):
        return f"{which} moved before view {movement.shot} ({size})"
    return f"the views of {which} before and from {movement.shot} on could not be brought together ({size} apart)"
