"""Sound and broken recordings of mirror balls, for the verdicts on balls and lights."""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.verdict import Judged
from pipeline.calibration.lights.light_tables import measure_lights, place_in_stage
from pipeline.calibration.lights.light_verdicts import ball_verdicts, light_verdicts, why_not_measured
from pipeline.calibration.lights.mirror_ball import Ball, locate_ball, reflection_points
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rigid_alignment import align_rigid
from tests.support.rigs.cameras import look_at

RADIUS_M, BALLS, LIGHTS = 0.18, 6, 8
UNIT, STAND, OTHER = "radius 10 % wrong", "stand in the outline", "outline of another ball"


def eyes_around(rng: np.random.Generator, count: int = 4) -> dict[str, Camera]:
    """Cameras 2.5 m around the middle, at heights of their own, that look at it."""
    cameras = {}
    for number, turn in enumerate(2 * np.pi * np.arange(count) / count + rng.uniform(-0.3, 0.3, count)):
        center = np.array([2.5 * np.sin(turn), rng.uniform(-0.5, 0.5), 2.5 * np.cos(turn)])
        R, K = look_at(center, rng.uniform(-0.05, 0.05, 3)), np.array([[700.0, 0, 300], [0, 700, 310], [0, 0, 1]])
        cameras[f"cam{number}"] = Camera(R, -R @ center, K, np.array([-0.05, 0.02, 0, 0, 0]), 600, 620)
    return cameras


def outline(ball: np.ndarray, camera: Camera, noise_px: float, rng: np.random.Generator) -> np.ndarray:
    """Pixels where the cone from the camera touches the ball."""
    away = ball - camera.center
    distance = np.linalg.norm(away)
    u = np.cross(away / distance, [0.3, 1, 0.2])
    u /= np.linalg.norm(u)
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)[:, None]
    ring = np.cos(angle) * u + np.sin(angle) * np.cross(away / distance, u)
    circle = ball - away * (RADIUS_M / distance) ** 2 + ring * RADIUS_M * np.sqrt(1 - (RADIUS_M / distance) ** 2)
    return camera.project(circle)[0] + rng.normal(0, noise_px, (90, 2))


def ball_alarm(fault: str | None, seed: int, size: float = 0.1) -> bool:
    """Outlines in four cameras, good to 0.3 px; ball "0" is the one that is broken: a radius by a share `size`."""
    rng = np.random.default_rng(seed)
    cameras, places = eyes_around(rng), rng.uniform(-0.25, 0.25, (2, 3))
    found = {}
    for number, place in enumerate(places):
        lines = [outline(place, camera, 0.3, rng) for camera in cameras.values()]
        if number == 0 and fault == STAND:
            lines[0][30:50] += 6 * (lines[0][30:50] - lines[0].mean(0)) / 60
        if number == 0 and fault == OTHER:
            lines[0] = outline(places[1], cameras["cam0"], 0.3, rng)
        radius = (1 + size) * RADIUS_M if number == 0 and fault == UNIT else RADIUS_M
        found[str(number)] = locate_ball(list(cameras.values()), lines, radius)
    verdicts = ball_verdicts(found, {name: list(cameras) for name in found}, {}, CalibrateLights())
    return any(verdict.grade != "good" for verdict in verdicts if fault is None or verdict.name == "0")


NAMES, MOVED, DEAD, STRAY = "names of two lights exchanged", "light half a metre away", "LED dead", "spots at random"


def light_alarm(fault: str | None, seed: int, size: float = 0.5) -> bool:
    """Highlights of eight lights on six balls in four cameras, good to 0.03 px; L0 is the one that is broken.

    One that was moved was by `size`, metres.
    """
    rng = np.random.default_rng(seed)
    cameras, places = eyes_around(rng), rng.uniform(-0.25, 0.25, (BALLS, 3))
    lights = rng.normal(size=(LIGHTS, 3))
    lights *= 2.4 / np.linalg.norm(lights, axis=1, keepdims=True)
    names, shown = [f"L{k}" for k in range(LIGHTS)], lights.copy()
    survey = pd.DataFrame(lights + rng.normal(0, 0.02, lights.shape), columns=["x", "y", "z"]).assign(light=names)
    if fault == NAMES:
        survey["light"] = [names[1], names[0], *names[2:]]
    if fault == MOVED:
        shown[0] += size * np.cross(shown[0], [0.3, 0.5, 0.8]) / np.linalg.norm(np.cross(shown[0], [0.3, 0.5, 0.8]))
    rows = []
    for b, place in enumerate(places):
        for name, camera in cameras.items():
            ends = (np.tile(place, (LIGHTS, 1)), RADIUS_M, np.tile(camera.center, (LIGHTS, 1)), shown)
            points = reflection_points(*ends)
            normal = (points - place) / RADIUS_M
            facing = [(normal * (target - points)).sum(1) > 0.5 for target in (camera.center, shown)]
            pixels = camera.project(points)[0] + rng.normal(0, 0.03, (LIGHTS, 2))
            for k in np.flatnonzero(facing[0] & facing[1]):
                rows.append((names[k], str(b), name, *pixels[k]))
    spots = pd.DataFrame(rows, columns=["light", "position", "camera", "x", "y"])
    if fault == DEAD:
        spots = spots[spots.light != "L0"]
    if fault == STRAY:
        spots.loc[spots.light == "L0", ["x", "y"]] += rng.uniform(-30, 30, ((spots.light == "L0").sum(), 2))
    flux = dict.fromkeys(("flux", "flux_r", "flux_g", "flux_b"), 1.0)
    spots = spots.reset_index(drop=True).assign(saturated=False, distance=0.5, **flux)
    balls = {str(b): Ball(place, 1e-8 * np.eye(3), 0.1, 1.0) for b, place in enumerate(places)}
    settings = CalibrateLights()
    facts, _ = measure_lights(spots, balls, cameras, RADIUS_M, names, settings)
    facts = facts.assign(images=BALLS * len(cameras))
    facts["why"] = [why_not_measured(row, settings) for _, row in facts.iterrows()]
    table = place_in_stage(facts, survey, align_rigid(lights, lights), True, settings)
    verdicts = light_verdicts(table, settings)
    return any(verdict.grade != "good" for verdict in verdicts if fault is None or verdict.name == "L0")


BALL = Judged("light_verdicts.ball_verdicts", (UNIT, STAND, OTHER), ball_alarm)
LIGHT = Judged("light_verdicts.light_verdicts", (NAMES, MOVED, DEAD, STRAY), light_alarm)
