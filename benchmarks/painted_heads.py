"""Procedural heads in other colours than their own, and what fully lit pictures show of their eyes and skin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks.bench_gaze import PATCHES_M, RADIUS_M
from pipeline.capture.images import read_image
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.eyes.eye_pixels import EyePixels, join_views, seen_pixels
from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth
from pipeline.geometry.rotations import matrix_from_quaternion
from pipeline.synthesis.eyeball import EYE_CENTERS_M, EYE_NAMES, EYE_RADIUS_M
from pipeline.synthesis.head import Head
from pipeline.synthesis.head_appearance import IRIS, PUPIL, SCLERA, SKIN
from pipeline.synthesis.photography import FrameJob, take
from pipeline.synthesis.renderer_choice import choose_renderer
from pipeline.synthesis.stage_rig import build_stage_rig
from pipeline.synthesis.studio import Studio
from pipeline.synthesis.subject import Moment

IN_FRONT_DEG = 75.0
"""Cameras that see a face: those this near to straight ahead of the stage's centre."""


@dataclass(frozen=True)
class Look:
    """A head's seed, and what it is painted with.

    Attributes:
        skin, iris: linear albedo; all colours of the skin, lips and brows included, change by the same factors.
        gloss_alpha: GGX width of the skin's gloss.
    """

    seed: str
    skin: tuple[float, float, float]
    iris: tuple[float, float, float]
    gloss_alpha: float


@dataclass(frozen=True)
class ShownHead:
    """A head as its cameras show it.

    Attributes:
        pixels: of each eye and each patch of skin (`PATCHES_M`) by name, in each frame.
        gaze: unit direction in which the eyes look in each frame, in the head's frame.
    """

    pixels: dict[str, list[EyePixels]]
    gaze: list[np.ndarray]


def settings_for(look: Look, file: Path) -> SynthesizeCapture:
    """The settings of a subject's file, with the head's gloss."""
    given = yaml.safe_load(file.read_text())["synthesize_capture"]
    return SynthesizeCapture(**{**given, "gloss_alpha": look.gloss_alpha})


def painted(head: Head, look: Look) -> Head:
    """The head in other colours; whites of eyes and pupils stay."""
    eyes = head.eye_texture.copy()
    iris = ~np.isclose(eyes, SCLERA).all(2) & ~np.isclose(eyes, PUPIL).all(2)
    eyes[iris] *= (np.array(look.iris) / IRIS).astype(np.float32)
    skin = np.clip(head.texture * (np.array(look.skin) / SKIN), 0.01, 0.9).astype(np.float32)
    return replace(head, texture=skin, eye_texture=eyes)


def photograph_head(
    head: Head, seed: str, settings: SynthesizeCapture, times_s: Sequence[float], folder: Path
) -> ShownHead:
    """Photograph fully lit frames into `folder` by the cameras in front, and take the pixels of eyes and skin.

    Meshes and cameras are the true ones.
    """
    rig = build_stage_rig(seed, settings)
    ahead = np.cos(np.radians(IN_FRONT_DEG))
    front = {name: c for name, c in rig.cameras.items() if c.center[2] > ahead * np.linalg.norm(c.center)}
    studio = Studio(folder, seed, settings, replace(rig, cameras=front), choose_renderer(settings)[0])
    each_light = np.full(settings.lights, settings.total_intensity / settings.lights)
    shown = ShownHead({name: [] for name in (*EYE_NAMES, *PATCHES_M)}, [])
    for frame, time_s in enumerate(times_s):
        moment = head.at(time_s, "a")
        take(FrameJob(studio, head, frame, moment, each_light))
        pictures = [
            _seen(
                head, moment, camera.downsampled(settings.downsample_from_sensor),
                read_image(folder / f"images/{name}/{frame:06d}.exr"),
            )
            for name, camera in front.items()
        ]  # fmt: skip
        for name, frames in shown.pixels.items():
            frames.append(join_views([picture[name] for picture in pictures]))
        shown.gaze.append(moment.gaze[EYE_NAMES[0]])
    return shown


def _seen(head: Head, moment: Moment, camera: Camera, image: np.ndarray) -> dict[str, EyePixels]:
    """What one picture shows of each eye past the skin, and of each patch of skin."""
    turn, shift = matrix_from_quaternion(moment.truth["root_rotation"]), moment.truth["root_translation"]
    pose = np.column_stack([turn.T, -turn.T @ shift])
    skin = draw_depth(camera, moment.vertices, head.faces[head.materials[0].faces])
    behind = draw_depth(camera, moment.vertices, head.faces) + np.float32(RADIUS_M)
    eyes = {
        name: seen_pixels(camera, image, skin, pose, center, EYE_RADIUS_M)
        for name, center in zip(EYE_NAMES, EYE_CENTERS_M, strict=True)
    }
    patches = {
        name: seen_pixels(camera, image, behind, pose, np.array(place), RADIUS_M) for name, place in PATCHES_M.items()
    }
    return eyes | patches
