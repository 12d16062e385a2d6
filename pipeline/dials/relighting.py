"""Dials of relight_avatar: size of an environment map for shadows, and for lobes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.exr import write_exr
from pipeline.capture.images import read_exr_channel
from pipeline.dials.dial import CostedStage, Dial, Files, Metric
from pipeline.dials.subject import Subject
from pipeline.lighting.environment import Environment

TOLERANCE = 0.01
"""RMS over the subject, relative to its RMS brightness: the noise of a capture, 1 %."""

SKY_HEIGHT = 256
"""Rows of the panorama under which settings are compared: a pixel of 0.7 degrees."""

SUN = np.array([0.5, 0.6, 0.62])
SUN_RADIANCE, SUN_DEGREES = 2000.0, 1.0
"""A disc of twice the sun's true radius, so that it covers pixels; it gives about as much light as the sky."""

HORIZON, ZENITH, GROUND = np.array([[0.9, 0.95, 1.0], [0.15, 0.35, 0.9], [0.12, 0.1, 0.08]])

PICTURES = {"pictures": 2, "height": 416, "width": 320, "stills": "exr", "splats": "none", "background": "black"}


def outdoors() -> Environment:
    """A clear sky over dark ground, with a sun: hard shadows and soft ones, linear RGB.

    The sky falls from horizon to zenith with the root of the height; the sun is a disc of even radiance.
    """
    directions = Environment(np.zeros((SKY_HEIGHT, 2 * SKY_HEIGHT, 3), np.float32)).directions()
    up = directions[..., 1:2]
    sky = HORIZON + (ZENITH - HORIZON) * np.sqrt(np.clip(up, 0, 1))
    radiance = np.where(up > 0, sky, GROUND)
    in_sun = directions @ (SUN / np.linalg.norm(SUN)) > np.cos(np.radians(SUN_DEGREES))
    radiance[in_sun] = SUN_RADIANCE
    return Environment(radiance.astype(np.float32))


def write_outdoors(path: Path) -> None:
    """The panorama as a file that relight_avatar reads."""
    write_exr(path, dict(zip("RGB", np.moveaxis(outdoors().radiance, 2, 0), strict=True)))


def _brightness(subject: Subject, output: Files, expected: Files) -> float:
    """Over all pixels of all pictures; there is nothing behind the subject."""
    squares = total = 0.0
    for still in sorted(expected["stills"].glob("*.exr")):
        for channel in "RGB":
            found, wanted = (read_exr_channel(files["stills"] / still.name, channel) for files in (output, expected))
            squares += float(np.square(found - wanted, dtype=np.float64).sum())
            total += float(np.square(wanted, dtype=np.float64).sum())
    return float(np.sqrt(squares / total))


def _pictures(output: Files) -> int:
    """Pictures that were rendered."""
    return len(list(output["stills"].glob("*.exr")))


RELIGHTING = CostedStage(
    name="relight_avatar",
    # Without an index and cameras the path around the subject is the same for all of them.
    files={
        "environment": "{made}/outdoors.exr", "relit": "{out}/relit", "index": None, "cameras": None, "textures": None,
    },
    inputs=("atlas.safetensors", "tracking/0000.safetensors", "avatars/{variant}/avatar.safetensors"),
    outputs={"stills": ("relit/stills", None)},
    metrics=(Metric("relit pixel, RMS over the subject's own", _brightness, lambda subject: TOLERANCE),),
    unit="pictures",
    work=_pictures,
    settings=PICTURES,
    makes={"outdoors.exr": write_outdoors},
)  # fmt: skip

RELIGHTING_DIALS = [
    Dial(
        "environment_shadows", RELIGHTING, "environment_height", lambda subject: (4, 8, 16, 32, 64),
        chosen=True,
    ),
    Dial(
        # Chosen by nobody: the default avatar is lit by the pixels of a map.
        "environment_lobes", RELIGHTING, "prefiltered_height", lambda subject: (16, 32, 64, 128, None),
    ),
]  # fmt: skip
