"""Gaze from detected irises, and eyes that detected contours say are closed.

A detector's iris is the circle where cornea and eyeball meet. Its middle lies on the eye's axis, at a distance from the
eye's centre that the eye's shape gives: each image of it is a direction. The mean over images is weighed against what
the pixels say, by the variances of both, which grow where the two disagree; where pixels say nothing, irises stand in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.eyes.eye_pixels import meet_sphere
from pipeline.eyes.eye_shape import EyeShape
from pipeline.eyes.gaze_estimate import LEAST_VIEWS, GazeEstimate
from pipeline.geometry.cameras import Camera

SIDES = ("left", "right")

CORNERS = {"left": ("face_42", "face_45"), "right": ("face_39", "face_36")}
LIDS = {
    "left": (("face_43", "face_47"), ("face_44", "face_46")), "right": (("face_37", "face_41"), ("face_38", "face_40")),
}  # fmt: skip
"""Points of iBUG's contours: the corners of an eye, and points of its lids that lie above each other."""

CLOSED = 0.1
"""Height of the gap between lids, over the eye's width, up to which an eye counts as closed: less than half of an open
one's, a quarter to a third."""

LEAST_ERROR_PX = 0.5
"""Of an iris in an image: a detector's outlines are good to no less."""

FAR_DEG = 15.0
"""Angle from the median direction beyond which an image's iris is left out: half of an iris's width."""


@dataclass(frozen=True)
class IrisView:
    """Axis of an eye by one image of its iris, in the head's frame.

    With its standard deviation, radians.
    """

    axis: Float64[np.ndarray, "3"]
    sigma: float


def see_iris(
    pixel: Float64[np.ndarray, "2"], camera: Camera, head: Float64[np.ndarray, "3 4"],
    center: Float64[np.ndarray, "3"], shape: EyeShape,
) -> IrisView:  # fmt: skip
    """Axis of an eye whose iris has its middle at a pixel.

    Args:
        head: [R | t], head from world.
        center: of the eyeball in the head's frame, metres.
    """
    R, t = head[:, :3], head[:, 3]
    away = shape.radius_m * np.cos(shape.limbus_angle)
    origin = R @ camera.center + t - center
    way = R @ camera.ray_directions(pixel[None])[0]
    along = meet_sphere(origin[None], way[None], away)[0][0]
    # A ray that passes the eye comes nearest at its rim.
    hit = origin + (-(origin @ way) if np.isnan(along) else along) * way
    depth = float(np.linalg.norm(origin))
    return IrisView(hit / np.linalg.norm(hit), LEAST_ERROR_PX * depth / camera.K[0, 0] / away)


def openness(points: Mapping[str, np.ndarray], side: str) -> float:
    """Height of the gap between an eye's lids over its width; NaN without a whole contour."""
    corners, lids = CORNERS[side], LIDS[side]
    if not {*corners, *lids[0], *lids[1]} <= set(points):
        return float("nan")
    width = np.linalg.norm(points[corners[0]] - points[corners[1]])
    heights = [np.linalg.norm(points[upper] - points[lower]) for upper, lower in lids]
    return float(np.mean(heights) / max(width, np.finfo(np.float64).tiny))


def combine_irises(estimate: GazeEstimate, views: list[IrisView], gaps: list[float]) -> GazeEstimate:
    """Combine the pixels' estimate of one eye in one frame with its irises and contours.

    Args:
        gaps: `openness` in the images; an eye is closed if that is so in most.
    """
    known = [gap for gap in gaps if np.isfinite(gap)]
    if known and float(np.median(known)) < CLOSED:
        return replace(estimate, status="hidden", direction=np.full(3, np.nan), sigma_deg=np.nan)
    axes = np.array([view.axis for view in views]).reshape(-1, 3)
    if len(axes):
        middle = np.median(axes, axis=0)
        near = axes @ (middle / np.linalg.norm(middle)) > np.cos(np.radians(FAR_DEG))
        views = [view for view, kept in zip(views, near, strict=True) if kept]
        axes = axes[near]
    if len(views) < LEAST_VIEWS:
        return estimate
    mean = axes.mean(0) / np.linalg.norm(axes.mean(0))
    # Over two angles; of images that agree by chance, what a detector can do at best.
    spread = np.sqrt(((axes - mean) ** 2).sum(1).sum() / (len(axes) - 1) / 2)
    sigma = float(np.degrees(max(spread, float(np.mean([view.sigma for view in views]))) / np.sqrt(len(axes))))
    if estimate.status != "estimated":
        return replace(estimate, status="estimated", direction=mean, sigma_deg=sigma, views=len(views))
    weights = np.array([estimate.sigma_deg, sigma]) ** -2.0
    joint = weights @ np.stack([estimate.direction, mean])
    apart = np.degrees(np.arctan2(np.linalg.norm(np.cross(estimate.direction, mean)), estimate.direction @ mean))
    # Chi-square of two angles over its mean: what is farther apart than both say is known less well than they say.
    wider = max(1.0, apart / np.sqrt(2 * (weights**-1).sum()))
    return replace(estimate, direction=joint / np.linalg.norm(joint), sigma_deg=float(wider * weights.sum() ** -0.5))


def add_irises(
    estimates: Mapping[str, list[GazeEstimate]], points: pd.DataFrame, frames: list[int], cameras: Mapping[str, Camera],
    heads: Mapping[int, np.ndarray], spheres: Mapping[str, np.ndarray], shapes: Mapping[str, EyeShape],
) -> dict[str, list[GazeEstimate]]:  # fmt: skip
    """Combine the estimates of all eyes with the detected points of eyes.

    Args:
        points: frame, camera, point, x, y of training cameras.
        frames: of the estimates, in their order.
        heads: [R | t], head from world, by frame.
        spheres: centre and radius of each eye in the head's frame.
    """
    seen: dict[tuple[str, int, str], list[tuple[str, Mapping[str, np.ndarray]]]] = {}
    for (frame, camera), rows in points[points.frame.isin(frames)].groupby(["frame", "camera"]):
        if camera not in cameras:
            continue
        found = {row.point: np.array([row.x, row.y], np.float64) for row in rows.itertuples()}
        for name, side in _sides(found, cameras[camera], heads[frame], spheres).items():
            seen.setdefault((name, frame, side), []).append((camera, found))
    combined = {}
    for name, own in estimates.items():
        combined[name] = []
        for frame, estimate in zip(frames, own, strict=True):
            shown = [(c, side, found) for side in SIDES for c, found in seen.get((name, frame, side), [])]
            views = [
                see_iris(found[f"{side}_pupil"], cameras[c], heads[frame], spheres[name][:3], shapes[name])
                for c, side, found in shown if f"{side}_pupil" in found
            ]  # fmt: skip
            gaps = [openness(found, side) for _, side, found in shown]
            combined[name].append(combine_irises(estimate, views, gaps))
    return combined


def _sides(
    found: Mapping[str, np.ndarray], camera: Camera, head: np.ndarray, spheres: Mapping[str, np.ndarray]
) -> dict[str, str]:
    """The detected side that each eye of the template is in one image, if it is within an eye's width of it."""
    R, t = head[:, :3], head[:, 3]
    sides = {}
    for name, sphere in spheres.items():
        pixel, depth = camera.project(((sphere[:3] - t) @ R)[None])
        reach = 2 * sphere[3] * camera.K[0, 0] / max(float(depth[0]), 1e-6)
        apart = {
            side: float(np.linalg.norm(np.mean([found[p] for p in mine], axis=0) - pixel[0]))
            for side in SIDES
            if (mine := [p for p in (f"{side}_pupil", *CORNERS[side]) if p in found])
        }
        if apart and min(apart.values()) < reach:
            sides[name] = min(apart, key=lambda side: apart[side])
    return sides
