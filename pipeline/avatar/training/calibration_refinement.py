"""Looks at training images that tell what to change in the calibration, by all processes."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float32

from pipeline.avatar.frames.camera_offsets import CAMERAS_AS_CALIBRATED, CameraOffsets
from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_gains import LightGains
from pipeline.avatar.model import Avatar
from pipeline.avatar.training.camera_refinement import refined_cameras
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.distributed import Processes
from pipeline.avatar.training.light_refinement import (
    Sigmas,
    assembled,
    changes_by_moving,
    refined_gains,
    told_apart,
)
from pipeline.avatar.training.picture_equations import PictureEquations, image_equations
from pipeline.avatar.training.seen_surface import seen_surface
from pipeline.base.spread import evenly
from pipeline.capture.records import ImageRecord
from pipeline.rendering.splat_types import CameraView

log = logging.getLogger("train_avatar")

MOST_LIGHTS, MOST_PARTS, IMAGES_PER_FRAME = 64, 512, 6
"""What is looked at: partially lit frames of at most so many lights, so many lights of frames together, and some images
of each frame. Every light of a frame is a picture of each of its images: time is theirs."""

LIGHTS_TOGETHER = 6
"""Lights whose pictures are blended together: about what a training step holds with its gradients."""

MOTION = 6
"""Unknowns of a camera."""


@dataclass(frozen=True)
class Look:
    """Equations from the images of one frame.

    Attributes:
        lights: equations of its lights' factors and, if they are refined, places; every other image in the second half.
        cameras: matrix, vector and errors of the motion of each image's camera, by its name.
    """

    lights: PictureEquations
    cameras: Mapping[str, tuple[np.ndarray, np.ndarray, float]]

    def as_json(self) -> dict:
        """Lists of numbers, every bit of them."""
        lights = [array.tolist() for array in vars(self.lights).values()]
        return {"lights": lights, "cameras": {n: [np.asarray(a).tolist() for a in c] for n, c in self.cameras.items()}}

    @staticmethod
    def from_json(look: Mapping) -> Look:
        """Read what `as_json` wrote."""
        cameras = {name: (np.array(a), np.array(b), float(c)) for name, (a, b, c) in look["cameras"].items()}
        return Look(PictureEquations(*map(np.array, look["lights"])), cameras)


def frames_to_look_at(table: pd.DataFrame, images_of: Mapping[int, Sequence[int]]) -> list[int]:
    """Partially lit frames with at least two images, evenly chosen.

    Args:
        table: of `FrameShards`.
        images_of: rows of each frame's images.
    """
    enough = table.frame.map(lambda number: len(images_of.get(number, ())) > 1).astype(bool)
    useful = table[~table.fully_lit & table.lights.between(1, MOST_LIGHTS) & enough].sort_values("frame")
    numbers = useful.frame.tolist()
    return evenly(numbers, max(1, len(numbers) * MOST_PARTS // max(1, int(useful.lights.sum()))))


def images_to_look_at(images: Sequence[int], place: int = 0) -> list[int]:
    """Some images of a frame, evenly chosen.

    Args:
        images: rows of the frame's images.
        place: at which the choice begins.
    """
    start = place % len(images)
    return sorted(evenly([*images[start:], *images[:start]], IMAGES_PER_FRAME))


@torch.no_grad()
def look_at(avatar: Avatar, frame: FrameInputs, images: Sequence[ImageRecord], sigmas: Sigmas) -> Look:
    """Equations of one frame.

    Args:
        avatar: as it is trained so far.
        frame: its pose and light.
        images: some of its training images.
        sigmas: which say what is refined.
    """
    lights, cameras = len(frame.record.light_positions), [camera_view(i, avatar.albedo.device) for i in images]
    pictures = light_pictures(avatar, frame, cameras)
    places = frame.gains.moved(frame.record.light_positions).astype(np.float64)
    look = Look(PictureEquations.none(lights * (4 if sigmas.light_m else 1)), {})
    for number, image in enumerate(images):
        parts, captured = np.stack([of_light[number] for of_light in pictures]), image.image
        subject, surface = image.mask > 1 - 1 / 255, None
        rows, rgb = parts[:, subject], parts.sum(0)
        if sigmas.light_m or sigmas.shift_m:
            surface = seen_surface(image, *frame.mesh)
        if sigmas.light_m:
            moved = [
                changes_by_moving(part, surface, subject, image.R @ place + image.t, image.R)
                for part, place in zip(rows, places, strict=True)
            ]
            rows = np.concatenate([rows, *moved])
        look.lights.add(number % 2, *image_equations(rows, rgb[subject], captured[subject]))
        if sigmas.shift_m:
            seen, columns = surface.seen, surface.motion_columns(rgb.astype(np.float64))
            look.cameras[image.camera] = image_equations(np.moveaxis(columns, -1, 0), rgb[seen], captured[seen])
    return look


def light_pictures(
    avatar: Avatar, frame: FrameInputs, cameras: Sequence[CameraView]
) -> list[list[Float32[np.ndarray, "h w 3"]]]:
    """Draw what each light of a frame shows by itself to each camera, by light and camera."""
    traced, pictures, lights = avatar.trace(frame), [], range(len(frame.record.light_positions))
    for first in lights[::LIGHTS_TOGETHER]:
        prepared = [avatar.prepare(traced.with_light(light)) for light in lights[first:][:LIGHTS_TOGETHER]]
        seen = [[picture.rgb.cpu().numpy() for picture in avatar.views(prepared, camera)] for camera in cameras]
        pictures += [list(of_light) for of_light in zip(*seen, strict=True)]
    return pictures


def refine_calibration(
    avatar: Avatar, frames: FrameStream, images_of: Mapping[int, Callable[[], Sequence[ImageRecord]]],
    gains: LightGains, sigmas: Sigmas, processes: Processes, mine: Callable[[int], bool],
) -> tuple[LightGains, CameraOffsets]:  # fmt: skip
    """Refine the lights of some frames and the cameras of their images.

    The result is the same in all processes.

    Args:
        avatar: as it is trained so far.
        frames: among which are those to look at.
        images_of: frames to look at, and what reads their training images, one frame's at a time; cameras as
            calibrated.
        gains: those that the frames are lit with.
        sigmas: typical changes to expect.
        processes: that share the frames.
        mine: whether a frame is this process' to render.
    """
    looked = {n: look_at(avatar, frames[n], images_of[n](), sigmas).as_json() for n in images_of if mine(n)}
    gathered = {int(n): look for part in processes.gather(looked) for n, look in part.items()}
    numbers = sorted(gathered)
    looks = [Look.from_json(gathered[n]) for n in numbers]
    refined, cameras = gains, CAMERAS_AS_CALIBRATED
    if sigmas.gain or sigmas.light_m:
        lights = [frames.records[n].light_positions for n in numbers]
        places, together = assembled(lights, [look.lights for look in looks], 4 if sigmas.light_m else 1)
        refined, gained, moved = refined_gains(places, together, gains, sigmas)
        told = told_apart(together.of(slice(len(places))))
        if told < len(places) and processes.is_main:
            log.warning("images tell only %d of %d lights apart: the others' light is like theirs, or not seen", told,
                        len(places))  # fmt: skip
        report_lights(gains, refined, gained, moved / max(float(together.errors.sum()), 1e-300), sigmas)
    if sigmas.shift_m:
        cameras, share = refined_cameras(by_camera(looks), sigmas)
        report_cameras(cameras, share)
    return refined, cameras


def by_camera(looks: Sequence[Look]) -> dict[str, PictureEquations]:
    """Equations of each camera; every other frame that it sees is in the second half."""
    cameras: dict[str, PictureEquations] = {}
    seen: dict[str, int] = {}
    for look in looks:
        for name, of_image in look.cameras.items():
            cameras.setdefault(name, PictureEquations.none(MOTION)).add(seen.setdefault(name, 0) % 2, *of_image)
            seen[name] += 1
    return dict(sorted(cameras.items()))


def report_lights(before: LightGains, refined: LightGains, gained: float, moved: float, sigmas: Sigmas) -> None:
    """Log what became of the lights; `moved` is the share of errors that moving them foretells."""
    if refined is before:
        log.info("lights stay as they are: other brightness would not fit images that had no part in finding it")
    elif sigmas.gain:
        spread = 100 * float(refined.factors.std())
        log.info(
            "%d lights' brightness refined by %.1f %%, squared errors fall by %.0f",
            len(refined.factors),
            spread,
            gained,
        )
    if not sigmas.light_m:
        return
    if refined.offsets_m is None:
        log.info("lights' places stay as calibrated: moving them foretells %.2f %% of squared errors", 100 * moved)
    else:
        rms = 1e3 * float(np.sqrt(np.square(refined.offsets_m).sum(1).mean()))
        log.info("lights moved by %.1f mm (RMS), %.2f %% of squared errors foretold", rms, 100 * moved)


def report_cameras(cameras: CameraOffsets, share: float) -> None:
    """Log what became of the cameras; `share` is that of the errors that their motions foretell."""
    if not len(cameras.names):
        log.info("cameras stay as calibrated: moving them foretells %.2f %% of squared errors", 100 * share)
        return
    turn, shift = (float(np.sqrt(np.square(m).sum(1).mean())) for m in np.split(cameras.motions, 2, axis=1))
    log.info(
        "%d cameras turned by %.2f mrad and moved by %.2f mm (RMS), %.2f %% of squared errors foretold",
        len(cameras.names), 1e3 * turn, 1e3 * shift, 100 * share,
    )  # fmt: skip
