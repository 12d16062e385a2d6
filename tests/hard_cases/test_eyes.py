"""Two-sphere eyes where an angle, a root or a ratio has no value, in float32 against closed forms and mpmath."""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
import torch

from benchmarks.mirror_glints import project
from pipeline.avatar.appearance.glossy import shade_specular
from pipeline.avatar.appearance.penalties import ROUGHNESS_BOUNDS
from pipeline.avatar.eyes.corneal_reflections import GRAZING, PIXEL_STD, mirror_pixels, trace_spheres
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.prepared import LidOcclusion, PosedEyes, Shading, ViewedParameters
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.eyes.eye_shape import EyeShape, eye_surface, turn_to
from pipeline.lighting.lobes import LOBE_CONSTANT
from pipeline.lighting.point_lights import PointLights
from pipeline.rendering.splat_types import CameraView
from tests.support.avatars.eyeballs import (
    AHEAD,
    CENTERS,
    make_atlas,
    make_avatar,
    make_eyes,
    make_frame,
    make_image,
)
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 2e-6
"""Two dozen operations of float32 on numbers of about 1, three of them roots."""

Z = [0.0, 0.0, 1.0]


def turned(gaze: list[float], dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor]:
    """Where the eye's side looks after the turn, and its derivative by the gaze."""
    at = torch.tensor(gaze, dtype=dtype, requires_grad=True)
    turn = turn_to(torch.tensor(Z, dtype=dtype), at)
    (slope,) = torch.autograd.grad((turn @ torch.tensor([0.6, 0.0, 0.8], dtype=dtype))[0], at)
    return turn, slope


def naive_slope(gaze: list[float]) -> torch.Tensor:
    """As `turned`, by Rodrigues' formula about axis x gaze and the angle acos(axis . gaze), lengths guarded."""
    at = torch.tensor(gaze, requires_grad=True)
    direction = torch.nn.functional.normalize(at, dim=0)
    axis = torch.nn.functional.normalize(torch.linalg.cross(torch.tensor(Z), direction), dim=0)
    angle, side = torch.acos(direction[2]), torch.tensor([0.6, 0.0, 0.8])
    across = torch.linalg.cross(axis, side)
    moved = side + torch.sin(angle) * across + (1 - torch.cos(angle)) * torch.linalg.cross(axis, across)
    return torch.autograd.grad(moved[0], at)[0]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_gaze_at_90_degrees(case: HardCase, side: float) -> None:
    turn, slope = turned([side, 0.0, 0.0], torch.float32)
    expected = np.array([[0, 0, side], [0, 1, 0], [-side, 0, 0]])
    exact = turned([side, 0.0, 0.0], torch.float64)[1]
    case.check(worst(turn, expected), FLOAT32, worst(slope, exact), FLOAT32)


def test_gaze_straight_ahead(case: HardCase) -> None:
    """By x the turned point moves as far as it is deep; axis and gaze span no plane there."""
    turn, slope = turned(Z, torch.float32)
    case.check(worst(turn, np.eye(3)), FLOAT32, worst(slope, [0.8, 0.0, 0.0]), FLOAT32)
    case.naive_fails(worst(naive_slope(Z), [0.8, 0.0, 0.0]), "gradient")


@pytest.mark.parametrize("length", [1e-6, 1e-3, 1e3])
def test_gaze_of_another_length(case: HardCase, length: float) -> None:
    gaze = [0.48 * length, -0.6 * length, 0.64 * length]
    exact, exact_slope = turned([0.48, -0.6, 0.64], torch.float64)
    turn, slope = turned(gaze, torch.float32)
    # At 1e-6 the squared quaternion is 3e-12, near its floor of 1e-12: nothing is lost.
    case.check(worst(turn, exact), FLOAT32, worst(slope * length, exact_slope), 5 * FLOAT32)


def test_gaze_of_length_zero(case: HardCase) -> None:
    """Says nothing: the eye rests. Its slope is finite."""
    turn, slope = turned([0.0, 0.0, 0.0], torch.float32)
    case.check(worst(turn, np.eye(3)), FLOAT32, 0.0 if torch.isfinite(slope).all() else math.nan, 0.0)
    gaze = torch.zeros(3)
    case.naive_fails((gaze / gaze.norm()).abs().max())


def test_gaze_backwards(case: HardCase) -> None:
    """No way is the shortest: the eye rests, and turns again as soon as there is one."""
    turn, slope = turned([0.0, 0.0, -1.0], torch.float32)
    case.check(worst(turn, np.eye(3)), FLOAT32, 0.0 if torch.isfinite(slope).all() else math.nan, 0.0)
    naive = naive_slope([0.0, 0.0, -1.0])
    case.naive_fails(0.0 if torch.isfinite(naive).all() else math.nan, "gradient")
    near = turned([1e-3, 0.0, -1.0], torch.float32)[0]
    case.check(worst(near @ torch.tensor(Z), np.array([1e-3, 0.0, -1.0]) / math.hypot(1e-3, 1.0)), 1e-4)


SHAPES = {
    "larger than the eyeball": (0.012, 0.0125, 0.004),
    "around the eyeball": (0.012, 0.018, 0.004),
    "as large, in one place": (0.012, 0.012, 0.0),
    "beside the eyeball": (0.012, 0.004, 0.020),
    "touching from inside": (0.012, 0.008, 0.004),
}


@pytest.mark.parametrize("which", SHAPES)
def test_cornea(case: HardCase, which: str) -> None:
    """Against the last point on each ray that lies in either ball, and against its differences."""
    rng = np.random.default_rng(0)
    w = rng.normal(size=(400, 3))
    w = torch.tensor(w / np.linalg.norm(w, axis=1, keepdims=True), dtype=torch.float32)
    sizes = [torch.tensor(size, requires_grad=True) for size in SHAPES[which]]
    found = eye_surface(w, torch.tensor(Z), *sizes)
    slopes = torch.autograd.grad(found.points.norm(dim=1).sum(), sizes, allow_unused=True, materialize_grads=True)
    exact = [size.item() for size in sizes]
    distance = farthest(w.double().numpy(), exact)
    steps = 1e-7 * np.eye(3)
    differences = [
        (farthest(w.double().numpy(), exact + step) - farthest(w.double().numpy(), exact - step)).sum() / 2e-7
        for step in steps
    ]
    if which == "as large, in one place":  # a kink: each direction belongs to one of the balls, any of them
        differences = [float(slope) for slope in slopes]
        assert sum(differences[:2]) == pytest.approx(len(w), rel=1e-4)
    gradient = worst([float(slope) for slope in slopes], differences, len(w))
    case.check(worst(found.points.norm(dim=1), distance), FLOAT32, gradient, 1e-3)
    case.check(worst(found.normals.norm(dim=1), np.ones(len(w))), FLOAT32)
    assert EyeShape(*SHAPES[which]).fault() == "" or which in ("larger than the eyeball", "around the eyeball",
                                                               "beside the eyeball")  # fmt: skip
    if which in ("around the eyeball", "beside the eyeball", "as large, in one place"):
        # Told apart by the angle of the circle in which the spheres meet, of which there is none.
        radius, cornea, offset = torch.tensor(SHAPES[which])
        limbus = torch.acos((radius**2 + offset**2 - cornea**2) / (2 * radius * offset))
        case.naive_fails(limbus)


def farthest(w: np.ndarray, sizes: np.ndarray | list[float]) -> np.ndarray:
    """Distance along unit directions to where the union of both balls ends, in float64; 0 < r_e is always inside."""
    radius, cornea, offset = sizes
    with np.errstate(invalid="ignore"):
        exit_cornea = offset * w[:, 2] + np.sqrt(cornea**2 - offset**2 * (w[:, 0] ** 2 + w[:, 1] ** 2))
    return np.fmax(radius, exit_cornea)


def box() -> tuple[np.ndarray, np.ndarray]:
    """Walls on all sides of both eyes: lids that are shut."""
    low, high = np.array([-0.06, -0.02, 0.04]), np.array([0.06, 0.04, 0.09])
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (high - low) + low
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([triangle for a, b, c, d in sides for triangle in ((a, b, c), (a, c, d))])


def test_closed_lids(case: HardCase) -> None:
    """No texel sees anything: nothing of the eyes is lit or mirrors, and no ratio of nothing to nothing is left."""
    atlas = make_atlas(48, box())
    avatar = make_avatar(atlas, make_eyes())
    frame = avatar.prepare(FrameInputs(atlas, make_frame(atlas, AHEAD, np.array([[0.1, 0.1, 1.5]]))))
    eyes = avatar.eyes.chosen
    layer = avatar.eyes.mirrors(frame.eyes, avatar.built.specular.samples(frame, ViewedParameters()))
    light = torch.cat([frame.eyes.lids.opening, frame.shading.diffuse[eyes].flatten(), layer[eyes].flatten()])
    image = make_image(np.array([0.0, 0.01, 1.0]), np.array([0.0, 0.01, 0.07]), 1.0, 96)
    picture = avatar.view(frame, camera_view(image))
    gradients = torch.autograd.grad(picture.rgb.sum() + light.sum(), [avatar.eyes.shift, avatar.log_roughness])
    finite = all(torch.isfinite(gradient).all() for gradient in gradients)
    case.check(light.detach().abs().max(), 0.0, 0.0 if finite else math.nan, 0.0)
    case.naive_fails((layer[eyes, 1].sum() / layer[eyes, 0].sum()).item())  # blended roughness over blended visibility


@pytest.mark.parametrize("sigma", ROUGHNESS_BOUNDS)
def test_light_exactly_in_the_mirror_direction(case: HardCase, sigma: float) -> None:
    """Camera and light on the cornea's axis. The peak of a lobe as wide as roughness and pixel has no slope across."""
    center, cornea, radius, focal = torch.zeros(3), torch.tensor([[0.0, 0.0, -1.0]]), 0.0078, 4e5
    at, width = cornea.clone().requires_grad_(), torch.tensor([[[0.5, 0.5 * sigma]]], requires_grad=True)
    K = torch.tensor([[focal, 0, 0.5], [0, focal, 0.5], [0, 0, 1.0]])
    R = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    eyes = PosedEyes(torch.eye(3)[None], at, torch.tensor([radius]), LidOcclusion(torch.ones(1), None))
    mirror = mirror_pixels(width, eyes, CameraView(R, center, K, 1, 1))[2]
    light, power = torch.tensor([[0.0, 0.0, 0.5]]), torch.full((1, 1), 3.0)
    out = shade_specular(mirror, center, PointLights(light, power))
    by_place, by_layer = torch.autograd.grad(out.sum(), (at, width))
    with mpmath.workdps(40):
        far = 1 - mpmath.mpf(radius)
        pixel = 2 * mpmath.mpf(PIXEL_STD) * far / focal / mpmath.mpf(radius)

        def peak(visibility: mpmath.mpf, weighed: mpmath.mpf) -> mpmath.mpf:
            roughness = weighed / visibility
            squared = roughness**2 + pixel**2
            return weighed / squared * mpmath.mpf(LOBE_CONSTANT) * 3 / (far + 0.5) ** 2

        stored = [mpmath.mpf(x) for x in width.flatten().tolist()]
        exact, slopes = peak(*stored), [mpmath.diff(peak, tuple(stored), order) for order in ((1, 0), (0, 1))]
    across = by_place[0, :2].abs().max() * sigma * radius / float(exact)
    case.check(worst(out, exact), FLOAT32, max(worst(by_layer.flatten(), slopes), float(across)), 5 * FLOAT32)
    normal = torch.tensor([0.0, 0.0, 1.0], requires_grad=True)
    angle = torch.acos((normal * torch.tensor(Z)).sum())
    (naive,) = torch.autograd.grad(torch.exp(-0.5 * (angle / sigma) ** 2), normal)
    case.naive_fails(naive.abs().max(), "gradient")


def test_light_behind_the_head(case: HardCase) -> None:
    """No point of an eye that a camera in front sees mirrors it, and none is lit by it."""
    atlas = make_atlas(48)
    avatar = make_avatar(atlas, make_eyes())
    frame = avatar.prepare(FrameInputs(atlas, make_frame(atlas, AHEAD, np.array([[0.0, 0.01, -1.2]]))))
    image = make_image(np.array([0.0, 0.01, 1.2]), np.array([0.0, 0.01, 0.07]), 0.5, 200)
    unlit = replace(frame, shading=Shading(torch.zeros_like(frame.shading.diffuse)))
    rgb = avatar.view(unlit, camera_view(image)).rgb
    gradients = torch.autograd.grad(rgb.sum(), [avatar.eyes.shift, avatar.eyes.growth, avatar.log_roughness])
    finite = all(torch.isfinite(gradient).all() for gradient in gradients)
    places = [project(image, center).astype(int) for center in CENTERS.values()]
    middle = [rgb[y - 8 : y + 9, x - 8 : x + 9] for x, y in places]
    case.check(max(part.detach().abs().max() for part in middle), 0.0, 0.0 if finite else math.nan, 0.0)


def naive_entries(origin: np.ndarray, rays: np.ndarray, centers: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Rays that the quadratic formula says meet a ball: at its nearer root, or the other if that lies behind."""
    toward = centers - origin
    along = rays @ toward.T
    root = np.sqrt(along**2 - (toward**2).sum(1) + radii**2)
    return (np.where(along - root > 0, along - root, along + root) > 0).any(1)


@pytest.mark.parametrize("where", ["centre of an eye", "inside", "on the cornea", "a hair before it"])
def test_camera_at(case: HardCase, where: str) -> None:
    """From inside no ray enters the eye; from a hair before it, those that look at it do, at once.

    From the cornea itself rounding decides which enter, there or at the ball below it; the one that looks away never.
    """
    shape = make_eyes()["eye_l"].shape
    apex = shape.cornea_offset_m + shape.cornea_radius_m
    depth = {"centre of an eye": 0.0, "inside": 0.006, "on the cornea": apex, "a hair before it": apex + 1e-4}[where]
    centers = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, shape.cornea_offset_m]], requires_grad=True)
    radii = torch.tensor([shape.radius_m, shape.cornea_radius_m], requires_grad=True)
    rays = torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.6, -0.8], [0.6, 0.0, 0.8]])
    rows, inside, points, normals = trace_spheres(torch.tensor([0.0, 0.0, depth]), rays, centers, radii)
    gradients = torch.autograd.grad(points.sum() + normals.sum() + 0 * radii.sum(), [centers, radii], allow_unused=True)
    finite = all(gradient is None or torch.isfinite(gradient).all() for gradient in gradients)
    entered = rows.tolist()
    if where == "on the cornea":
        ball = radii.double()[inside].detach()[:, None] * normals.detach().double() + centers.detach().double()[inside]
        expected, at = [row for row in entered if row != 2], ball
    elif where == "a hair before it":  # 0.8 away - root((0.8 away)^2 - away^2 + r^2) down the oblique ray
        away = shape.cornea_radius_m + 1e-4
        oblique = 0.8 * away - math.sqrt(shape.cornea_radius_m**2 - (0.6 * away) ** 2)
        expected, at = [0, 1], np.array([[0, 0, apex], [0, 0.6 * oblique, depth - 0.8 * oblique]])
    else:
        expected, at = [], np.zeros((0, 3))
    error = worst(points, at, apex) if entered == expected else 1.0
    case.check(error, 1e-6, 0.0 if finite else math.nan, 0.0)
    if where in ("centre of an eye", "inside"):
        arrays = [array.detach().double().numpy() for array in (rays, centers, radii)]
        case.naive_fails(naive_entries(np.array([0.0, 0.0, depth]), *arrays).sum() - len(entered))


def test_ray_that_touches_the_eye(case: HardCase) -> None:
    """It counts as a miss before the root's slope grows beyond any bound."""
    radii = torch.tensor([0.0125], requires_grad=True)
    heights = 0.0125 * torch.sqrt(1 - torch.tensor([0.0, 1e-6, 1e-3, 0.03, 0.1]) ** 2)
    rays = torch.stack([heights, 0 * heights, -torch.ones_like(heights)], 1)
    rays = rays / rays.norm(dim=1, keepdim=True)
    center = torch.tensor([[0.0, 0.0, -1.0]], requires_grad=True)
    _, _, points, normals = trace_spheres(torch.zeros(3), rays, center, radii)
    slope = torch.autograd.grad(points.sum() + normals.sum() * 0.0125, radii)[0].abs().max()
    rows = len(points)
    # A coordinate of a point, and of a normal times the radius, moves at most 1 / GRAZING times as far as the radius.
    steepest = 2 * rows * math.sqrt(3) / GRAZING
    # Points a metre away are good to 6e-8 m, five millionths of a radius.
    case.check(worst((points - center.detach()).norm(dim=1), np.full(rows, 0.0125)), 1e-5, slope / steepest, 1.0)
    below_root = (radii**2 - heights[0] ** 2).clamp_min(0)
    case.naive_fails(torch.autograd.grad(below_root.sqrt().sum(), radii)[0].abs().max(), "gradient")
