"""Jobs that take the photographs of a capture.

Each job is independent, seeded by what it shows, and writes its own files. Jobs are plain data, so that any number of
worker processes gives the same capture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.exr import save_exr
from pipeline.base.seeds import generator_for, seed_for
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.detector import detect_keypoints
from pipeline.synthesis.frame_rendering import FrameRenderer, LitSubject, LlvmRenderer, ScalarRenderer, Shot
from pipeline.synthesis.lens import LensView, view_points
from pipeline.synthesis.sensor_model import write_8bit
from pipeline.synthesis.studio import Studio
from pipeline.synthesis.subject import Moment, Subject
from pipeline.synthesis.target_photography import (
    BallJob,
    BoardJob,
    ChartJob,
    photograph_ball,
    photograph_board,
    photograph_chart,
)

LOOKED_FOR, SAME_SURFACE_M = 300, 1e-3
"""Points of an eye, 2 mm apart, that say where in an image it is seen; and their tolerance.

Nearer than this before a point, nothing that is hit hides it. The margin of a view, two pixels, is more than lies
between two points.
"""

COVERED = 0.5
"""A pixel belongs to the subject if the subject covers at least half of it."""


@dataclass(frozen=True)
class FrameJob:
    """One frame: the subject at that moment, and the radiant intensity of each light of the rig."""

    studio: Studio
    shown: Subject
    frame: int
    moment: Moment
    intensities: np.ndarray


Job = FrameJob | BoardJob | ChartJob | BallJob


def take(job: Job) -> pd.DataFrame | None:
    """Do a job; the detected keypoints of a frame, None for calibration images."""
    if isinstance(job, FrameJob):
        return _photograph_frame(job)
    if isinstance(job, BoardJob):
        return photograph_board(job)
    if isinstance(job, ChartJob):
        return photograph_chart(job)
    return photograph_ball(job)


def _photograph_frame(job: FrameJob) -> pd.DataFrame:
    settings, lit = job.studio.settings, job.intensities > 0
    paths = settings.spp_fully_lit if lit.all() else settings.spp
    subject = LitSubject(job.shown, job.moment, settings, job.studio.rig.lights_xyz[lit], job.intensities[lit], paths)
    if job.studio.renderer == "scalar":
        return _photograph_by(job, ScalarRenderer(subject))
    with scenes.llvm_variant():
        return _photograph_by(job, LlvmRenderer(subject))


def _photograph_by(job: FrameJob, renderer: FrameRenderer) -> pd.DataFrame:
    studio, settings = job.studio, job.studio.settings
    cameras = {name: c.downsampled(settings.downsample_from_sensor) for name, c in studio.rig.cameras.items()}
    shots = []
    for name, camera in cameras.items():
        seed = seed_for(studio.subject, "paths", name, job.frame) % 2**31
        shots.append(shots_of(camera, job.moment, renderer.scene, settings, seed))
    rendered = iter(renderer.render([shot for of_camera in shots for shot in of_camera]))
    detections = []
    for (name, camera), of_camera in zip(cameras.items(), shots, strict=True):
        developed = _developed(of_camera, [next(rendered) for _ in of_camera])
        random = generator_for(studio.subject, "sensor", name, job.frame)
        raw = studio.sensor_model.expose(developed[..., :3], studio.rig.raw_from_true[name], random)
        save_exr(studio.root / f"images/{name}/{job.frame:06d}.exr", raw)
        mask = np.where(developed[..., 3] >= COVERED, 255, 0).astype(np.uint8)
        write_8bit(studio.root / f"masks/{name}/{job.frame:06d}.png", mask)
        detections.append(_detect(job, renderer.scene, name, camera))
    return pd.concat(detections, ignore_index=True)


def shots_of(camera: Camera, moment: Moment, scene: Any, settings: SynthesizeCapture, seed: int) -> list[Shot]:
    """The whole subject in a camera's image, and close-ups of the eyes that it sees."""
    whole = view_points(camera, moment.reach, settings.supersampling)
    eyes = _eyes_in_view(moment, scene, camera, settings.supersampling)
    return [Shot(whole, seed), *(Shot(eye, seed, settings.spp_eyes / settings.spp) for eye in eyes)]


def _developed(shots: list[Shot], rendered: list[np.ndarray]) -> np.ndarray:
    """The image of the first shot, with the windows of the others in it."""
    image = shots[0].view.develop(rendered[0])
    for shot, closer in zip(shots[1:], rendered[1:], strict=True):
        x, y, width, height = shot.view.window
        window = slice(y, y + height), slice(x, x + width)
        image[window] = shot.view.develop(closer)[window]
    return image


def _eyes_in_view(moment: Moment, scene: Any, camera: Camera, samples: int) -> list[LensView]:
    """A view of each eye that is seen at least in part, to be rendered with more paths."""
    views = []
    for name in dict.fromkeys(surface.name for surface in moment.surfaces):
        points = np.concatenate([surface.vertices for surface in moment.surfaces if surface.name == name])
        points = points[:: max(1, len(points) // LOOKED_FOR)]
        ways = points - camera.center
        distances = np.linalg.norm(ways, axis=1)
        seen = scenes.hit_distances(scene, camera.center, ways / distances[:, None]) > distances - SAME_SURFACE_M
        if seen.any():
            views.append(view_points(camera, points[seen], samples))
    return views


def _detect(job: FrameJob, scene: object, name: str, camera: Camera) -> pd.DataFrame:
    settings, shown, keypoints = job.studio.settings, job.shown, job.moment.keypoints
    offsets = keypoints - camera.center
    distances = np.linalg.norm(offsets, axis=1)
    first_hit = scenes.hit_distances(scene, camera.center, offsets / distances[:, None])
    hidden = first_hit < distances - shown.keypoint_depth_m
    found = detect_keypoints(
        camera, keypoints, hidden, shown.keypoint_names, settings.keypoint_noise_px, settings.keypoint_outliers,
        generator_for(job.studio.subject, "keypoints", name, job.frame),
    )  # fmt: skip
    if not shown.detected_when_hidden:
        found = found[~hidden]
    found.insert(0, "frame", job.frame)
    found.insert(1, "camera", name)
    return found


def all_jobs(studio: Studio, frames: list[FrameJob]) -> list[Job]:
    """Every photograph of the capture, longest jobs first so that workers finish together."""
    names = list(studio.rig.cameras)
    ball_cameras = [names[i * len(names) // studio.settings.ball_cameras] for i in range(studio.settings.ball_cameras)]
    jobs: list[Job] = list(frames)
    jobs += [BoardJob(studio, name) for name in names]
    jobs += [BallJob(studio, position, n) for position in range(studio.settings.ball_positions) for n in ball_cameras]
    return jobs + [ChartJob(studio, name) for name in names]
