"""Fit of two-sphere eyes to the tracked vertices of the eye parts, and its file eyes.json.

The head's frame is that of the template at rest. In it an eye's part turns about a fixed centre; the turn that best
brings the resting part to the tracked one says where the eye's axis points, and the vertices' distances to the two
spheres are what is minimised.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.eyes.eye_shape import EyeShape, usual_shape
from pipeline.geometry.least_squares import Solution, solve_least_squares
from pipeline.geometry.rigid_alignment import align_rigid

log = logging.getLogger(__name__)

LEAST_VERTICES = 12
"""Twice the six numbers of an eye."""

LEAST_SIGMA_M = 1e-6
"""Vertices are never better known: float32 at the size of a head is good to a tenth of this."""

RADII_M = (0.004, 0.03)
"""Eyeballs of mammals from a cat's up to a horse's; what is outside is in another unit, or no sphere."""

LARGEST_SIGMA_M = 1e-3
"""Standard deviation of a centre or a radius beyond which the vertices do not say where the eye is."""

LEAST_BULGE_M = 3e-4
"""How far a cornea has to stand out to be taken for one: a third of the usual."""

FOLLOWING_DEG = 5.0
"""Tracked eyes whose axis is further off the gaze do not follow it: optical and visual axis of an eye differ by 5."""

Cornea = Literal["auto", "usual", "none"]


@dataclass(frozen=True)
class FittedEye:
    """One eye in the head's frame, metres.

    Attributes:
        center: c_e.
        axis: unit direction in which the eye of the template at rest looks.
        shape: of the two spheres.
        status: "cornea": the template shows one, which was fitted; "usual": it does not, and the cornea is that of an
            average eye of this size; "sphere": a plain sphere was asked for.
        sigma_m: standard deviations of centre (largest axis), radius, and of the cornea's radius and offset if fitted.
        rms_m: of the vertices' distances to the surface.
        gaze_rms_deg: of the angle between the tracked axis and the gaze.
        vertices: of the glTF file.
    """

    center: tuple[float, float, float]
    axis: tuple[float, float, float]
    shape: EyeShape
    status: Literal["cornea", "usual", "sphere"]
    sigma_m: dict[str, float]
    rms_m: float
    gaze_rms_deg: float
    vertices: tuple[int, ...]

    def as_json(self) -> dict:
        """The entry of eyes.json."""
        return {**{name: value for name, value in asdict(self).items() if name != "shape"}, **asdict(self.shape)}

    @classmethod
    def from_json(cls, stored: Mapping, where: str) -> FittedEye:
        """Read an entry that `as_json` gave.

        Raises:
            InputError: if keys are missing or the shape is none of an eye; `where` is named.
        """
        names = {field.name for field in (*fields(cls), *fields(EyeShape)) if field.name != "shape"}
        if stored.keys() != names:
            raise InputError(f"{where}: expected the keys {sorted(names)}, found {sorted(stored)}; run fit_eyes again")
        values = {name: tuple(value) if isinstance(value, list) else value for name, value in stored.items()}
        shape = EyeShape(**{field.name: float(values.pop(field.name)) for field in fields(EyeShape)})
        if shape.fault():
            raise InputError(f"{where}: {shape.fault()}; run fit_eyes again")
        return cls(shape=shape, **values)


def read_eyes(path: Path) -> dict[str, FittedEye]:
    """eyes.json, by name in sorted order.

    Raises:
        InputError: if it is not what fit_eyes writes.
    """
    return eyes_from_json(read_json(path), str(path))


def eyes_from_json(stored: Mapping[str, Mapping], where: str) -> dict[str, FittedEye]:
    """The same from what the file holds."""
    return {name: FittedEye.from_json(stored[name], f"{where}: {name}") for name in sorted(stored)}


def fit_eye(
    name: str, vertices: tuple[int, ...], rest: Float64[np.ndarray, "v 3"], tracked: Float64[np.ndarray, "frames v 3"],
    gaze: Float64[np.ndarray, "frames 3"], cornea: Cornea = "auto",
) -> FittedEye:  # fmt: skip
    """Fit one eye.

    Args:
        name: of the eye, for messages.
        vertices: numbers of its vertices in the glTF file.
        rest, tracked: the part at rest and in some frames, in the head's frame, metres.
        gaze: unit directions in those frames, in the head's frame.
        cornea: "usual": do not look for one in the template; "none": a plain sphere.

    Raises:
        InputError: if the vertices do not say where the eye is.
    """
    places = len(np.unique(rest, axis=0))
    if places < LEAST_VERTICES or not len(tracked):
        raise InputError(
            f"{name}: expected {LEAST_VERTICES} places of vertices and a frame with gaze, found {places} and "
            f"{len(tracked)}; see template.eyes and gaze in capture.yaml"
        )
    axis, axes, gaze_rms = tracked_axes(name, rest, tracked, gaze)
    points, axes = tracked.reshape(-1, 3), np.repeat(axes, len(rest), 0)
    ball = solve_least_squares(lambda x: _distances(x, points, axes), sphere_through(points), LEAST_SIGMA_M)
    sigma = _sigmas(ball, len(tracked))
    radius = float(ball.parameters[3])
    if not RADII_M[0] <= radius <= RADII_M[1] or sigma[:4].max() > LARGEST_SIGMA_M:
        raise InputError(
            f"{name}: expected vertices on a sphere with a radius of {1e3 * RADII_M[0]:g} to {1e3 * RADII_M[1]:g} mm, "
            f"found {1e3 * radius:.2f} mm, centre and radius good to {1e3 * sigma[:4].max():.2f} mm; check scale_to_m "
            "and that template.eyes lists eyeballs"
        )
    found, status, shape = ball, "usual", usual_shape(radius)
    if cornea == "none":
        status, shape = "sphere", EyeShape(radius, radius, 0.0)
    elif cornea == "auto" and (bulging := _with_cornea(ball, points, axes, len(tracked))) is not None:
        found, status, shape = bulging, "cornea", EyeShape(*bulging.parameters[3:].tolist())
    sigmas = dict(
        zip(("center", "radius", "cornea_radius", "cornea_offset"), _sizes(found, len(tracked)), strict=False)
    )
    rms = float(np.sqrt(np.mean(found.residual**2)))
    log.info("%s: radius %.2f mm, %s, vertices within %.3f mm (rms)", name, 1e3 * shape.radius_m, status, 1e3 * rms)
    if gaze_rms > FOLLOWING_DEG:
        log.warning("%s: the tracked eye is %.1f degrees (rms) off the gaze: it does not follow it", name, gaze_rms)
    center, looks = (tuple(map(float, vector)) for vector in (found.parameters[:3], axis))
    return FittedEye(center, looks, shape, status, sigmas, rms, gaze_rms, vertices)


def tracked_axes(
    name: str, rest: np.ndarray, tracked: np.ndarray, gaze: np.ndarray
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "frames 3"], float]:
    """The axis at rest, the tracked axis in every frame, and its rms angle to the gaze, degrees."""
    try:
        turns = np.stack([align_rigid(rest, part, LEAST_SIGMA_M).R for part in tracked])
    except ValueError as error:
        raise InputError(
            f"{name}: expected vertices that span an eyeball, found: {error}; see template.eyes"
        ) from error
    # The coordinatewise median: a third of the directions may be wrong.
    axis = np.median(np.einsum("fji,fj->fi", turns, gaze), axis=0)
    length = np.linalg.norm(axis)
    if not length > 0.5:
        raise InputError(f"{name}: expected gaze in about one direction on the turning eye, found all; check the gaze")
    axes = turns @ (axis / length)
    angles = np.arctan2(np.linalg.norm(np.cross(axes, gaze), axis=1), (axes * gaze).sum(1))
    return axis / length, axes, float(np.degrees(np.sqrt(np.mean(angles**2))))


def sphere_through(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "4"]:
    """Centre and radius of a sphere through points: the algebraic least-squares fit.

    |x|^2 = 2 c . x + (r^2 - |c|^2) is linear in them.
    """
    middle = points.mean(0)
    x = points - middle
    solved = np.linalg.lstsq(np.column_stack([2 * x, np.ones(len(x))]), (x * x).sum(1), rcond=None)[0]
    return np.append(solved[:3] + middle, np.sqrt(max(solved[3] + solved[:3] @ solved[:3], LEAST_SIGMA_M**2)))


def _distances(
    x: np.ndarray, points: np.ndarray, axes: np.ndarray
) -> tuple[Float64[np.ndarray, "n 1"], Float64[np.ndarray, "n unknowns"]]:
    """Signed distances to the union of the spheres, positive outside, and their derivatives.

    Derivatives are by centre, r_e, and, if they are among the unknowns, r_c and d.
    """
    offset = points - x[:3]
    length = np.linalg.norm(offset, axis=1)
    residual, jacobian = length - x[3], np.zeros((len(points), len(x)))
    jacobian[:, :3], jacobian[:, 3] = -offset / length[:, None], -1.0
    if len(x) == 6:
        from_cornea = offset - x[5] * axes
        distance = np.linalg.norm(from_cornea, axis=1)
        nearer = distance - x[4] < residual
        normal = from_cornea / distance[:, None]
        jacobian[nearer, :3], jacobian[nearer, 3] = -normal[nearer], 0.0
        jacobian[nearer, 4], jacobian[nearer, 5] = -1.0, -(normal * axes).sum(1)[nearer]
        residual = np.where(nearer, distance - x[4], residual)
    return residual[:, None], jacobian


def _with_cornea(ball: Solution, points: np.ndarray, axes: np.ndarray, frames: int) -> Solution | None:
    """Both spheres, if the vertices show a cornea."""
    offset = points - ball.parameters[:3]
    in_front = (offset * axes).sum(1) > np.cos(usual_shape(1.0).limbus_angle) * np.linalg.norm(offset, axis=1)
    if not in_front.any():
        return None
    start = usual_shape(float(ball.parameters[3]))
    # Over the cap, a bulge is on average half as high as in its middle.
    bulge = max(2 * float(np.median(ball.residual[in_front])), LEAST_BULGE_M)
    start = np.array([start.radius_m, start.cornea_radius_m, start.radius_m + bulge - start.cornea_radius_m])
    found = solve_least_squares(
        lambda x: _distances(x, points, axes), np.append(ball.parameters[:3], start), LEAST_SIGMA_M
    )
    shape = EyeShape(*found.parameters[3:].tolist())
    stands_out = shape.cornea_offset_m + shape.cornea_radius_m - shape.radius_m
    known = _sigmas(found, frames).max() < LARGEST_SIGMA_M
    return found if not shape.fault() and stands_out > LEAST_BULGE_M and known else None


def _sigmas(found: Solution, frames: int) -> Float64[np.ndarray, " unknowns"]:
    """Standard deviations, as if there were one frame.

    The others repeat the same vertices' errors.
    """
    return np.sqrt(np.diag(found.covariance) * frames)


def _sizes(found: Solution, frames: int) -> list[float]:
    """Standard deviations of the centre's least known coordinate and of each size."""
    sigmas = _sigmas(found, frames)
    return [float(sigmas[:3].max()), *sigmas[3:].tolist()]
