"""The stage from above and from the side, with all that was calibrated.

Shown are cameras, lights with their uncertainty, survey, balls and boards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.spatial
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, Patch, Polygon

from pipeline.base.verdicts import Grade
from pipeline.calibration.lights.light_tables import COVARIANCE
from pipeline.figures.labels import place_labels
from pipeline.figures.style import FAINT, GRADE_COLORS, GRADE_INKS, INK, MUTED, picture, round_factor
from pipeline.geometry.cameras import Camera

CAMERA, BALL, BOARD = "#0072b2", "#cc79a7", "#9aa3af"

FRUSTUM_SHARE, ELLIPSE_SHARE, ROOM_SHARE = 0.07, 0.02, 0.06
"""Sizes in the picture, as shares of the stage's extent.

Depth of a frustum, median half axis of a magnified ellipse, room beyond the outermost.
"""

LIGHT_MARKS: dict[Grade, str] = {"good": "o", "weak": "^", "failed": "X"}
MARK_PT: dict[Grade, float] = {"good": 2.0, "weak": 4.0, "failed": 7.0}
"""Marks in the middle of the ellipses, and their sizes. Weak and failed show without colours, too."""

MOST_NAMES = 40
"""Cameras up to which all are named; of more, only those that are not good."""

VIEW_INCHES = 6.2


@dataclass(frozen=True)
class Stage:
    """Everything with a place, in the stage's frame, metres.

    Attributes:
        lights: lights.parquet.
        survey: light, x, y, z: index/lights.parquet.
        balls: centre of the ball at each position.
        boards: corners of boards.
    """

    cameras: Mapping[str, Camera]
    lights: pd.DataFrame
    survey: pd.DataFrame
    balls: Mapping[str, Float64[np.ndarray, "3"]]
    ball_radius_m: float
    boards: Sequence[Float64[np.ndarray, "corners 3"]]


def light_covariances(lights: pd.DataFrame) -> Float64[np.ndarray, "lights 3 3"]:
    """Covariance of each light's position, square metres.

    NaN for lights that keep their surveyed position.
    """
    full = np.empty((len(lights), 3, 3))
    rows, columns = np.triu_indices(3)
    full[:, rows, columns] = full[:, columns, rows] = lights[COVARIANCE].to_numpy(np.float64)
    return full


def one_sigma_ellipse(covariance: Float64[np.ndarray, "2 2"]) -> tuple[float, float, float]:
    """Full axes of the ellipse x^T C^-1 x = 1, and the angle of the first in degrees.

    The angle is from the first coordinate axis.
    """
    value, vector = np.linalg.eigh(covariance)
    first, second = 2 * np.sqrt(np.maximum(value, 0))
    return float(first), float(second), float(np.degrees(np.arctan2(vector[1, 0], vector[0, 0])))


def draw_rig(path: Path, stage: Stage, grades: Mapping[tuple[str, str], Grade]) -> None:
    """Write a PNG with the stage seen from above (along -y) and from the side (along -z).

    Args:
        grades: of (kind, name), kinds camera and light.
    """
    places = _places(stage)
    extent = float(np.ptp(places, axis=0).max())
    sigma = np.sqrt(np.trace(light_covariances(stage.lights), axis1=1, axis2=2) / 3)
    factor, notes = 1.0, ["The lights are where the survey has them; no light was measured."]
    if np.isfinite(sigma).any():
        factor = round_factor(ELLIPSE_SHARE * extent / float(np.nanmedian(sigma)))
        notes = [
            f"Lights are 1 sigma ellipses of their position, magnified {factor:g} times; all else is to scale.",
            "A long line from a hollow circle: the light is not where it was surveyed, or names are swapped.",
        ]
    if hidden := len(stage.cameras) > MOST_NAMES:
        notes += [f"Only cameras that are not good are named, of {len(stage.cameras)}."]
    named = [name for name in stage.cameras if not hidden or grades.get(("camera", name), "good") != "good"]
    depth_m = FRUSTUM_SHARE * extent * min(1.0, (MOST_NAMES / len(stage.cameras)) ** 0.5)
    size = (2 * VIEW_INCHES + 0.3, VIEW_INCHES + 0.4)
    with picture(path, size, "The stage", notes, _legend(stage)) as figure:
        width, height = figure.get_size_inches()
        for k, (across, up, title) in enumerate(((0, 2, "from above"), (0, 1, "from the side"))):
            left = 0.55 + k * (VIEW_INCHES + 0.1)
            box = (left / width, 0.5 / height, (VIEW_INCHES - 0.45) / width, (VIEW_INCHES - 0.45) / height)
            axes = figure.add_axes(box)
            _set_limits(axes, places, extent, (across, up))
            axes.set_title(title, loc="left", weight="bold", size=9)
            axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]", aspect="equal")
            axes.grid(color=FAINT, linewidth=0.4)
            axes.set_axisbelow(True)
            _draw_targets(axes, stage, (across, up))
            _draw_lights(axes, stage, grades, (across, up), factor)
            _draw_cameras(axes, stage, grades, (across, up), depth_m)
            _name(axes, stage, named, grades, (across, up))


def _legend(stage: Stage) -> list[Line2D | Patch]:
    graded = [
        Line2D([], [], color=color, marker=LIGHT_MARKS[grade], linestyle="", label=f"light, {grade}")
        for grade, color in GRADE_COLORS.items()
    ]
    survey = Line2D([], [], color=MUTED, marker="o", fillstyle="none", markersize=4, label="surveyed", linewidth=0.8)
    legend = [Line2D([], [], color=CAMERA, label="camera"), *graded, survey]
    if stage.balls:
        legend += [Line2D([], [], color=BALL, marker="o", linestyle="", label="mirror ball")]
    if stage.boards:
        what = f"{len(stage.boards)} boards, the extent of their corners"
        legend += [Patch(facecolor=BOARD, alpha=0.4, label=what)]
    return legend


def _places(stage: Stage) -> np.ndarray:
    centers = [camera.center for camera in stage.cameras.values()]
    points = [table[["x", "y", "z"]].to_numpy(np.float64) for table in (stage.lights, stage.survey)]
    return np.concatenate([np.stack(centers), *points])


def _set_limits(axes: Axes, places: np.ndarray, extent: float, plane: tuple[int, int]) -> None:
    """Set limits so that both views show a cube of the same side.

    From above, z points down, towards an observer who looks along -z.
    """
    middle = (places.min(0) + places.max(0))[list(plane)] / 2
    half = (0.5 + ROOM_SHARE + FRUSTUM_SHARE / 2) * extent
    axes.set(xlim=(middle[0] - half, middle[0] + half))
    upwards = -1 if plane[1] == 2 else 1
    axes.set(ylim=(middle[1] - upwards * half, middle[1] + upwards * half))


def _draw_targets(axes: Axes, stage: Stage, plane: tuple[int, int]) -> None:
    for corners in stage.boards:
        flat = corners[:, list(plane)]
        hull = flat[scipy.spatial.ConvexHull(flat, qhull_options="QJ").vertices]
        axes.add_patch(Polygon(hull, facecolor=BOARD, edgecolor=MUTED, alpha=0.2, linewidth=0.6))
    for center in stage.balls.values():
        axes.add_patch(Circle(center[list(plane)], stage.ball_radius_m, color=BALL, alpha=0.7, linewidth=0))


def _draw_lights(
    axes: Axes, stage: Stage, grades: Mapping[tuple[str, str], Grade], plane: tuple[int, int], factor: float
) -> None:
    surveyed = stage.survey.set_index("light").loc[stage.lights.light, ["x", "y", "z"]].to_numpy(np.float64)
    found = stage.lights[["x", "y", "z"]].to_numpy(np.float64)
    pairs = np.stack([surveyed, found], 1)[..., list(plane)]
    axes.add_collection(LineCollection(list(pairs), colors=MUTED, linewidths=0.8), autolim=False)
    axes.scatter(*pairs[:, 0].T, s=14, facecolors="none", edgecolors=MUTED, linewidths=0.7)
    covariances = light_covariances(stage.lights)[:, plane][:, :, plane]
    for name, place, covariance in zip(stage.lights.light, pairs[:, 1], covariances, strict=True):
        grade = grades.get(("light", name), "good")
        color = GRADE_COLORS[grade]
        axes.plot(*place, LIGHT_MARKS[grade], color=color, markersize=MARK_PT[grade], markeredgewidth=0)
        if np.isfinite(covariance).all():
            width, height, angle = one_sigma_ellipse(covariance)
            shape = {"width": factor * width, "height": factor * height, "angle": angle}
            axes.add_patch(Ellipse(place, **shape, facecolor=color, alpha=0.6, linewidth=0))


def _draw_cameras(
    axes: Axes, stage: Stage, grades: Mapping[tuple[str, str], Grade], plane: tuple[int, int], depth_m: float
) -> None:
    for name, camera in stage.cameras.items():
        w, h = float(camera.width), float(camera.height)
        framing = camera if camera.lens.perspective else camera.pinhole()
        rays = framing.ray_directions(np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float64))
        corners = camera.center + depth_m * rays / (rays @ camera.R[2])[:, None]
        flat, apex = corners[:, list(plane)], camera.center[list(plane)]
        grade = grades.get(("camera", name), "good")
        color = CAMERA if grade == "good" else GRADE_COLORS[grade]
        lines = [np.concatenate([flat, flat[:1]]), *(np.stack([apex, corner]) for corner in flat)]
        order = 2 if grade == "good" else 3
        axes.add_collection(LineCollection(lines, colors=color, linewidths=0.8, zorder=order), autolim=False)


def _name(
    axes: Axes, stage: Stage, cameras: Sequence[str], grades: Mapping[tuple[str, str], Grade], plane: tuple[int, int]
) -> None:
    """Name these cameras, and the lights that are not good."""
    weak = [name for name in stage.lights.light if grades.get(("light", name), "good") != "good"]
    lights = stage.lights.set_index("light")[["x", "y", "z"]]
    centers = np.stack([camera.center for camera in stage.cameras.values()])
    points = [*(stage.cameras[name].center for name in cameras), *lights.loc[weak].to_numpy(np.float64)]
    kinds = [*(("camera", name) for name in cameras), *(("light", name) for name in weak)]
    if not points:
        return
    inks = [GRADE_INKS[grades.get(key, "good")] for key in kinds]
    obstacles = np.concatenate([lights.to_numpy(np.float64), centers])[:, list(plane)]
    lost = place_labels(axes, np.stack(points)[:, list(plane)], [name for _, name in kinds], inks, obstacles)
    if lost:
        axes.annotate(f"{lost} names left out for lack of room", (1, 1), xycoords="axes fraction", ha="right",
                      va="bottom", size=7, color=INK)  # fmt: skip
