"""Photographs of calibration targets: board, colour chart, mirror ball. Each job writes its own files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.exr import save_exr
from pipeline.base.seeds import generator_for
from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.lens import view_points, whole_grid
from pipeline.synthesis.prints import render_print
from pipeline.synthesis.sensor_model import write_8bit
from pipeline.synthesis.studio import Studio
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

SILHOUETTE_SAMPLES = 4
"""Paths per fine pixel of a silhouette: it has no shading, so only edges need them."""

HIGHLIGHT_SAMPLES = 16
"""Paths per fine pixel of a highlight. It has few pixels, and lights are measured by their centroid."""

HIGHLIGHT_SUPERSAMPLING = 4
"""Fine pixels per sensor pixel along one axis for highlights. These are about one pixel wide."""

DARK, HIGHLIGHT, BACKDROP = 0.012, 0.9, 0.7
"""Values of a dark stage, a pixel filled by a light's reflection, and the bright backdrop.

Saturation is 1.
"""


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


def photograph_board(job: BoardJob) -> None:
    """Write an 8-bit picture of each pose of the board that the camera sees."""
    studio = job.studio
    camera, texture = studio.rig.cameras[job.camera], board_texture(studio.settings)[..., 1:2]
    grid = whole_grid(camera, studio.settings.supersampling)
    for index, corners in enumerate(board_poses(studio.subject, studio.settings)):
        if not sees_board(camera, corners):
            continue
        radiance = _photograph_print(texture, corners, camera, studio.settings.supersampling, grid)
        random = generator_for(studio.subject, "board sensor", job.camera, index)
        image = studio.sensor_model.expose_gray(radiance[..., 0] + DARK, random)
        write_8bit(studio.root / f"calibration/charuco/{job.camera}/{index:03d}.jpg", image)


def photograph_chart(job: ChartJob) -> None:
    """Write one linear picture of the chart."""
    studio, camera = job.studio, job.studio.rig.cameras[job.camera]
    corners = chart_corners(camera, generator_for(studio.subject, "chart", job.camera))
    radiance = CHART_LIGHT * _photograph_print(chart_texture(), corners, camera, studio.settings.supersampling)
    random = generator_for(studio.subject, "chart sensor", job.camera)
    raw = studio.sensor_model.expose(radiance, studio.rig.raw_from_true[job.camera], random)
    save_exr(studio.root / f"calibration/color_chart/{job.camera}.exr", raw)


def _photograph_print(
    texture: np.ndarray, corners: np.ndarray, camera: Camera, supersampling: int, grid: np.ndarray | None = None
) -> np.ndarray:
    edges = np.linspace(0, 1, 20)[:, None]  # distorted edges bulge: follow them
    outline = np.concatenate([a + edges * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    view = view_points(camera, outline, supersampling, grid=grid)
    return view.develop(render_print(texture, corners, view))


def photograph_ball(job: BallJob) -> None:
    """Write 8-bit pictures of the ball, one per light, and its silhouette."""
    studio, settings, camera = job.studio, job.studio.settings, job.studio.rig.cameras[job.camera]
    center, radius = ball_centers(studio.subject, settings)[job.position], settings.ball_radius_m
    folder = studio.root / f"calibration/mirror_ball/{job.position}/{job.camera}"
    for name, light in studio.rig.light_positions.items():
        value = np.full((camera.height, camera.width), DARK)
        reflected = reflections(camera.center, sphere_points(light, settings.light_radius_m), center, radius)
        if len(reflected):
            scene = scenes.mirror_ball_scene(center, radius, light, settings.light_radius_m)
            view = view_points(camera, reflected, HIGHLIGHT_SUPERSAMPLING)
            value += HIGHLIGHT * view.develop(scenes.render(scene, view, HIGHLIGHT_SAMPLES, seed=0))[..., 1]
        random = generator_for(studio.subject, "ball sensor", job.position, job.camera, name)
        write_8bit(folder / f"{name}.png", studio.sensor_model.expose_gray(value, random))
    scene = scenes.mirror_ball_scene(center, radius, 1e3 * np.ones(3), settings.light_radius_m)
    view = view_points(camera, sphere_points(center, radius), settings.supersampling)
    coverage = view.develop(scenes.render(scene, view, SILHOUETTE_SAMPLES, seed=0))[..., 3]
    random = generator_for(studio.subject, "ball sensor", job.position, job.camera)
    silhouette = studio.sensor_model.expose_gray(DARK + BACKDROP * (1 - coverage), random)
    write_8bit(folder / "silhouette.png", silhouette)
