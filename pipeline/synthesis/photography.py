"""Jobs that take the photographs of a capture.

Each job is independent, seeded by what it shows, and writes its own files. Jobs are plain data, so that any number of
worker processes gives the same capture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.seeds import generator_for, seed_for
from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.detector import detect_keypoints
from pipeline.synthesis.lens import LensView, view_points
from pipeline.synthesis.sensor_model import write_8bit, write_exr
from pipeline.synthesis.studio import Studio
from pipeline.synthesis.subject import Moment, Subject, vertex_normals
from pipeline.synthesis.target_photography import (
    SILHOUETTE_SAMPLES,
    BallJob,
    BoardJob,
    ChartJob,
    photograph_ball,
    photograph_board,
    photograph_chart,
)
from pipeline.synthesis.translucency import Medium, translucent_mesh

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
    studio, settings = job.studio, job.studio.settings
    translucent = settings.material == "translucent"
    scene = _lit_subject(job, translucent)
    # Light may cross a translucent body as if it were not there, so its coverage comes from the opaque one.
    opaque = _lit_subject(job, False) if translucent else None
    paths = settings.spp_fully_lit if (job.intensities > 0).all() else settings.spp
    detections = []
    for name, sensor_camera in studio.rig.cameras.items():
        camera = sensor_camera.downsampled(settings.downsample_from_sensor)
        view = view_points(camera, job.moment.vertices, settings.supersampling)
        seed = seed_for(studio.subject, "paths", name, job.frame) % 2**31
        developed = view.develop(_render_lit(job, scene, view, paths, seed))
        for eye in _eyes_in_view(job.moment, scene, camera, settings.supersampling):
            x, y, width, height = eye.window
            window = slice(y, y + height), slice(x, x + width)
            closer = max(1, round(paths * settings.spp_eyes / settings.spp))
            developed[window] = eye.develop(_render_lit(job, scene, eye, closer, seed))[window]
        random = generator_for(studio.subject, "sensor", name, job.frame)
        raw = studio.sensor_model.expose(developed[..., :3], studio.rig.raw_from_true[name], random)
        write_exr(studio.root / f"images/{name}/{job.frame:06d}.exr", raw)
        if opaque is not None:
            developed[..., 3] = view.develop(scenes.render(opaque, view, SILHOUETTE_SAMPLES, seed))[..., 3]
        mask = np.where(developed[..., 3] >= COVERED, 255, 0).astype(np.uint8)
        write_8bit(studio.root / f"masks/{name}/{job.frame:06d}.png", mask)
        found = _detect(job, scene, name, camera)
        detections.append(found)
    return pd.concat(detections, ignore_index=True)


def _lit_subject(job: FrameJob, translucent: bool) -> Any:
    """The subject under the lights that are on, as a Mitsuba scene."""
    shown, settings, vertices = job.shown, job.studio.settings, job.moment.vertices
    cut, normals = shown.unwrapped, vertex_normals(vertices, shown.faces)
    medium = Medium(settings.mean_free_path_m, settings.scattering_albedo)
    meshes = []
    for material in shown.materials:
        geometry = (vertices[cut.source], normals[cut.source], cut.faces[material.faces], cut.uv)
        if translucent and material.solid:
            meshes.append(translucent_mesh(medium, material.gloss_alpha, *geometry))
        else:
            meshes.append(scenes.coated_mesh(shown.texture, material.gloss_alpha, *geometry))
    for surface in job.moment.surfaces:
        geometry = (surface.vertices, surface.normals, surface.faces, surface.uv, surface.ior)
        meshes.append(scenes.coated_mesh(surface.texture, surface.gloss_alpha, *geometry))
    lights, intensities = _lit_lights(job)
    if settings.light_choice == "all":
        lights, intensities = lights[:1], intensities[:1]
    integrator = "volpath" if translucent else "path"
    return scenes.lit_scene(meshes, lights, intensities, settings.max_depth, integrator)


def _lit_lights(job: FrameJob) -> tuple[np.ndarray, np.ndarray]:
    lit = job.intensities > 0
    return job.studio.rig.lights_xyz[lit], job.intensities[lit]


def _render_lit(job: FrameJob, scene: Any, view: LensView, paths: int, seed: int) -> np.ndarray:
    """Image of a scene of `_lit_subject` in a view, under all lights that are on.

    About `paths` paths are traced per image pixel.
    """
    settings, (lights, intensities) = job.studio.settings, _lit_lights(job)
    samples = paths / settings.supersampling**2
    if settings.light_choice == "drawn":
        return scenes.render(scene, view, max(1, round(samples)), seed)
    return scenes.render_each_light(scene, view, lights, intensities, max(1, round(samples / len(lights))), seed)


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
