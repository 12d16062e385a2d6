"""Taking the pictures: each job is independent, seeded by what it shows, and writes its own files.

Jobs are plain data, so that any number of worker processes gives the same capture.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.seeds import generator_for, seed_for
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.detector import detect_keypoints
from pipeline.synthesis.lens import LensView, view_points
from pipeline.synthesis.sensor_model import SensorModel, write_8bit, write_exr
from pipeline.synthesis.stage_rig import StageRig
from pipeline.synthesis.subject import Moment, Subject, vertex_normals
from pipeline.synthesis.targets import (
    CHART_LIGHT,
    ball_centers,
    board_poses,
    board_texture,
    chart_corners,
    chart_texture,
    reflections,
    sees_board,
    sphere_points,
)  # fmt: skip
from pipeline.synthesis.translucency import Medium, translucent_mesh

PRINT_SAMPLES = 4
"""Paths per fine pixel of a print: its shading has no noise, so only edges need them."""

HIGHLIGHT_SAMPLES = 16
"""Paths per fine pixel of a highlight: few pixels, and their centroid is what lights are measured by."""

HIGHLIGHT_SUPERSAMPLING = 4
"""Fine pixels per sensor pixel along one axis for highlights, which are about one pixel wide."""

DARK, HIGHLIGHT, BACKDROP = 0.012, 0.9, 0.7
"""Values of a dark stage, of a pixel filled by a light's reflection, and of the bright backdrop, of 1 = saturated."""

LOOKED_FOR, SAME_SURFACE_M = 300, 1e-3
"""Points of an eye, 2 mm apart, that say where in an image it is seen; what is hit nearer than this before one hides
it. The margin of a view, two pixels, is more than lies between two points."""

COVERED = 0.5
"""A pixel belongs to the subject if the subject covers at least half of it."""


@dataclass(frozen=True)
class Studio:
    """What every photograph needs: where it is stored, whose capture it is, with what it is taken."""

    root: Path
    subject: str
    settings: SynthesizeCapture
    rig: StageRig

    @property
    def sensor_model(self) -> SensorModel:
        """The cameras' common noise."""
        s = self.settings
        return SensorModel(s.shot_gain, s.read_noise, s.saturation, s.black_level)


@dataclass(frozen=True)
class FrameJob:
    """One frame: the subject at that moment, and the radiant intensity of each light of the rig."""

    studio: Studio
    shown: Subject
    frame: int
    moment: Moment
    intensities: np.ndarray


@dataclass(frozen=True)
class BoardJob:
    """All board views of one camera."""

    studio: Studio
    camera: str


@dataclass(frozen=True)
class ChartJob:
    """The colour chart before one camera."""

    studio: Studio
    camera: str


@dataclass(frozen=True)
class BallJob:
    """The mirror ball in one position, before one camera, under each light in turn."""

    studio: Studio
    position: int
    camera: str


Job = FrameJob | BoardJob | ChartJob | BallJob


def take(job: Job) -> pd.DataFrame | None:
    """Do a job; the detected keypoints of a frame, None for calibration images."""
    if isinstance(job, FrameJob):
        return _photograph_frame(job)
    if isinstance(job, BoardJob):
        return _photograph_board(job)
    if isinstance(job, ChartJob):
        return _photograph_chart(job)
    return _photograph_ball(job)


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
            developed[..., 3] = view.develop(scenes.render(opaque, view, PRINT_SAMPLES, seed))[..., 3]
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
    """A view of a scene of `_lit_subject` under all lights that are on, about `paths` per image pixel."""
    settings, (lights, intensities) = job.studio.settings, _lit_lights(job)
    samples = paths / settings.supersampling**2
    if settings.light_choice == "drawn":
        return scenes.render(scene, view, max(1, round(samples)), seed)
    return scenes.render_each_light(scene, view, lights, intensities, max(1, round(samples / len(lights))), seed)


def _eyes_in_view(moment: Moment, scene: Any, camera: Camera, samples: int) -> list[LensView]:
    """A view of each eye of which something is seen, to be rendered with more paths than the rest."""
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


def _photograph_board(job: BoardJob) -> None:
    studio = job.studio
    camera, texture = studio.rig.cameras[job.camera], board_texture(studio.settings)
    for index, corners in enumerate(board_poses(studio.subject, studio.settings)):
        if not sees_board(camera, corners):
            continue
        radiance = _photograph_print(texture, corners, camera, studio.settings.supersampling)
        random = generator_for(studio.subject, "board sensor", job.camera, index)
        image = studio.sensor_model.expose_gray(radiance[..., 1] + DARK, random)
        write_8bit(studio.root / f"calibration/charuco/{job.camera}/{index:03d}.jpg", image)


def _photograph_chart(job: ChartJob) -> None:
    studio, camera = job.studio, job.studio.rig.cameras[job.camera]
    corners = chart_corners(camera, generator_for(studio.subject, "chart", job.camera))
    radiance = CHART_LIGHT * _photograph_print(chart_texture(), corners, camera, studio.settings.supersampling)
    random = generator_for(studio.subject, "chart sensor", job.camera)
    raw = studio.sensor_model.expose(radiance, studio.rig.raw_from_true[job.camera], random)
    write_exr(studio.root / f"calibration/color_chart/{job.camera}.exr", raw)


def _photograph_print(texture: np.ndarray, corners: np.ndarray, camera: Camera, supersampling: int) -> np.ndarray:
    edges = np.linspace(0, 1, 20)[:, None]  # distorted edges bulge: follow them
    outline = np.concatenate([a + edges * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    view = view_points(camera, outline, supersampling)
    return view.develop(scenes.render(scenes.print_scene(texture, corners), view, PRINT_SAMPLES, seed=0))[..., :3]


def _photograph_ball(job: BallJob) -> None:
    studio, settings, camera = job.studio, job.studio.settings, job.studio.rig.cameras[job.camera]
    center, radius = ball_centers(studio.subject, settings)[job.position], settings.ball_radius_m
    folder = studio.root / f"calibration/mirror_ball/{job.position}/{job.camera}"
    for name, light in studio.rig.light_positions.items():
        value = np.full((camera.height, camera.width), DARK)
        glints = reflections(camera.center, sphere_points(light, settings.light_radius_m), center, radius)
        if len(glints):
            scene = scenes.mirror_ball_scene(center, radius, light, settings.light_radius_m)
            view = view_points(camera, glints, HIGHLIGHT_SUPERSAMPLING)
            value += HIGHLIGHT * view.develop(scenes.render(scene, view, HIGHLIGHT_SAMPLES, seed=0))[..., 1]
        random = generator_for(studio.subject, "ball sensor", job.position, job.camera, name)
        write_8bit(folder / f"{name}.png", studio.sensor_model.expose_gray(value, random))
    scene = scenes.mirror_ball_scene(center, radius, 1e3 * np.ones(3), settings.light_radius_m)
    view = view_points(camera, sphere_points(center, radius), settings.supersampling)
    coverage = view.develop(scenes.render(scene, view, PRINT_SAMPLES, seed=0))[..., 3]
    random = generator_for(studio.subject, "ball sensor", job.position, job.camera)
    silhouette = studio.sensor_model.expose_gray(DARK + BACKDROP * (1 - coverage), random)
    write_8bit(folder / "silhouette.png", silhouette)


def all_jobs(studio: Studio, frames: list[FrameJob]) -> list[Job]:
    """Every photograph of the capture, longest jobs first so that workers finish together."""
    names = list(studio.rig.cameras)
    ball_cameras = [names[i * len(names) // studio.settings.ball_cameras] for i in range(studio.settings.ball_cameras)]
    jobs: list[Job] = list(frames)
    jobs += [BoardJob(studio, name) for name in names]
    jobs += [BallJob(studio, position, n) for position in range(studio.settings.ball_positions) for n in ball_cameras]
    return jobs + [ChartJob(studio, name) for name in names]
