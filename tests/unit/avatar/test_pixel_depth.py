"""Depth for deferred shading: against a plane and a sphere whose depth and whose glint are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from pipeline.avatar.appearance.glossy import GlossySamples, shade_specular
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.geometry.pixel_depth import depth_of_pixels, points_of_pixels
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.geometry.camera_paths import look_at
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.lighting.point_lights import PointLights
from pipeline.rendering.splat_types import CameraView
from tests.support.avatars.sheet import make_frame, make_sheet
from tests.support.avatars.splat_by_names import splat_supersampled

SOURCES = ("expected", "normalised", "median", "traced")
SIDE = 64
RADIUS_M, SPHERE_TEXELS = 0.3, 20000
SIGMA = 0.03
"""Lobe width, radians: wide enough for the glint to cover some pixels, too narrow for falloff to shift it."""

ROUNDING = 2e-6
"""Of float32, in which places of pixels are: some operations on numbers that are a hundred times the result."""

CAMERA = look_at(np.array([0.0, 0.0, 1.2]), np.zeros(3), 34.0, SIDE, SIDE)
EYE = torch.tensor(CAMERA.center, dtype=torch.float32)
LIGHT_M = np.array([0.45, 0.2, 0.7])
PIXEL_M = 0.9 / CAMERA.K[0, 0]
"""What a pixel covers at the front of the sphere."""


VIEW = camera_view(CAMERA)


def discs(points, normals, spacing, opacity):
    """Thin discs on a surface, one texel spacing apart."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    tangent = np.cross(normals, helper)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    frames = np.stack([tangent, np.cross(normals, tangent), normals], 2)
    return {
        "means": torch.tensor(points, dtype=torch.float32),
        "quaternions": torch.tensor(quaternion_from_matrix(frames), dtype=torch.float32),
        "scales": torch.tensor([[0.6, 0.6, 0.1]]).repeat(len(points), 1) * spacing,
        "opacities": torch.full((len(points),), opacity),
        "features": torch.tensor(normals, dtype=torch.float32),
    }


def sphere(opacity):
    """The half of it that faces the camera, as the avatar culls the other one, and its mesh."""
    k = np.arange(SPHERE_TEXELS) + 0.5
    z, turn = 1 - 2 * k / SPHERE_TEXELS, np.pi * (1 + 5**0.5) * k
    normals = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], 1)
    facing = ((CAMERA.center - RADIUS_M * normals) * normals).sum(1) > 0
    spacing = RADIUS_M * np.sqrt(4 * np.pi / SPHERE_TEXELS)
    ball = trimesh.creation.icosphere(5, RADIUS_M)
    mesh = np.asarray(ball.vertices, np.float64), np.asarray(ball.faces, np.int64)
    return discs(RADIUS_M * normals[facing], normals[facing], spacing, opacity), mesh


def with_wall(gaussians, mesh, behind_m=0.4):
    """A dull wall behind the sphere."""
    x, y = np.mgrid[-80:81, -80:81].reshape(2, -1) * 0.005
    points = np.stack([x, y, np.full(len(x), -behind_m)], 1)
    wall = discs(points, np.tile([[0.0, 0, 1]], (len(x), 1)), 0.005, 0.95)
    corners = np.array([[-1.0, -1, -behind_m], [1, -1, -behind_m], [1, 1, -behind_m], [-1, 1, -behind_m]])
    vertices, faces = mesh
    both = {name: torch.cat([gaussians[name], wall[name]]) for name in wall}
    quad = np.array([[0, 1, 2], [0, 2, 3]]) + len(vertices)
    return both, (np.concatenate([vertices, corners]), np.concatenate([faces, quad]))


def seen(gaussians, mesh, source):
    """Picture, depth and the points of all pixels."""
    camera = {"R": VIEW.R, "t": VIEW.t, "K": VIEW.K, "width": SIDE, "height": SIDE}
    picture = splat_supersampled(**gaussians, **camera, median_depth=source == "median")
    depth = depth_of_pixels(source, picture, mesh if source == "traced" else None, VIEW)
    row, column = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    points = points_of_pixels(row.flatten(), column.flatten(), depth.flatten(), VIEW)
    return picture, depth, points


def sphere_depth():
    """Of the sphere along each pixel's ray, and where the ray meets it well inside the outline (50 degrees)."""
    x, y = ((np.arange(SIDE) + 0.5 - SIDE / 2) / CAMERA.K[0, 0],) * 2
    slope2 = x[None, :] ** 2 + y[:, None] ** 2
    under_root = 1.2**2 - (1 + slope2) * (1.2**2 - RADIUS_M**2)
    depth = (1.2 - np.sqrt(under_root.clip(0))) / (1 + slope2)
    return depth, (depth * np.sqrt(slope2) < 0.75 * RADIUS_M) & (under_root > 0)


def mirror_pixel_of_sphere():
    """Where the normal halves the angle between light and camera: in the plane of the three, by the angle from z."""
    across = LIGHT_M * [1, 1, 0] / np.linalg.norm(LIGHT_M[:2])

    def off(angle):
        normal = np.sin(angle) * across + np.cos(angle) * np.array([0, 0, 1.0])
        to_light, to_eye = LIGHT_M - RADIUS_M * normal, CAMERA.center - RADIUS_M * normal
        return normal @ to_light / np.linalg.norm(to_light) - normal @ to_eye / np.linalg.norm(to_eye)

    angle = brentq(off, 0.0, 1.2)
    normal = np.sin(angle) * across + np.cos(angle) * np.array([0, 0, 1.0])
    return CAMERA.project(RADIUS_M * normal)[0]


def glint_pixel(brightness):
    """Centroid of a highlight in pixels; squared, so that its faint skirts do not count."""
    weight = brightness**2
    rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


def glint_error_px(gaussians, mesh, source):
    """Of the highlight on the sphere, shaded at the points that a depth source gives, with the true normals."""
    _, _, points = seen(gaussians, mesh, source)
    depth, inside = sphere_depth()
    row, column = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    true = torch.tensor(depth.flatten(), dtype=torch.float32)
    normals = points_of_pixels(row.flatten(), column.flatten(), true, VIEW) / RADIUS_M
    ones = torch.ones(SIDE * SIDE)
    light = torch.tensor(LIGHT_M, dtype=torch.float32)[None]
    samples = GlossySamples(points, normals, SIGMA * ones, ones)
    lit = shade_specular(samples, EYE, PointLights(light, torch.ones(1, 1)))
    brightness = lit[:, 0].numpy().reshape(SIDE, SIDE) * inside
    return float(np.linalg.norm(glint_pixel(brightness) - mirror_pixel_of_sphere()))


@pytest.mark.parametrize(("source", "typical", "largest"), [
    # The discs are 7.5 mm apart and those of one pixel do not agree to more than a part of that.
    ("normalised", 2.5e-3, 5e-3), ("median", 2.5e-3, 6e-3),
    ("traced", 1e-4, 3e-4),  # facets of 1 cm on a sphere of 30 cm: a sag of 0.05 mm, seen at up to 50 degrees
])  # fmt: skip
def test_depth_of_an_opaque_sphere(source, typical, largest):
    _, depth, _ = seen(*sphere(0.95), source)
    true, inside = sphere_depth()
    error = np.abs(depth.numpy() - true)[inside]
    assert np.median(error) < typical
    assert error.max() < largest


def test_expected_depth_is_as_much_too_near_as_alpha_is_too_small():
    picture, depth, _ = seen(*sphere(0.95), "expected")
    true, inside = sphere_depth()
    np.testing.assert_allclose(depth.numpy()[inside], (picture.alpha.numpy() * true)[inside], atol=5e-3)
    assert np.median(np.abs(depth.numpy() - true)[inside]) > 0.02


def glint_errors(*scene):
    return {source: glint_error_px(*scene, source) for source in SOURCES}


def test_glint_of_a_translucent_sphere_needs_more_than_the_expected_depth():
    """A fifth of a pixel is what the curvature under the lobe moves the centroid by."""
    opaque, translucent = glint_errors(*sphere(0.95)), glint_errors(*sphere(0.3))
    assert max(opaque.values()) < 0.5
    assert translucent["expected"] > 5
    assert max(translucent[source] for source in SOURCES[1:]) < 0.35


@pytest.mark.parametrize(("opacity", "moved_px"), [(0.95, 0.5), (0.3, 3.0)])
def test_glint_before_a_wall_needs_the_median_or_the_mesh(opacity, moved_px):
    """Even if only 3 % of the light reaches the wall, a mean of both depths is centimetres behind the surface."""
    errors = glint_errors(*with_wall(*sphere(opacity)))
    assert min(errors["expected"], errors["normalised"]) > moved_px
    assert max(errors["median"], errors["traced"]) < 0.35


def test_beside_the_mesh_the_splatted_depth_is_taken_and_nothing_has_a_gradient():
    gaussians, mesh = with_wall(*sphere(0.95))
    gaussians["means"].requires_grad_()
    vertices, faces = mesh
    _, plain, _ = seen(gaussians, mesh, "normalised")
    _, traced, _ = seen(gaussians, (vertices[:-4], faces[:-2]), "traced")
    corner = (slice(8, 11), slice(8, 11))  # the wall, which the mesh leaves out
    assert not plain.requires_grad and not traced.requires_grad
    assert torch.equal(traced[corner], plain[corner])
    assert float((plain[corner] - 1.6).abs().max()) < 5e-3
    assert not torch.equal(traced, plain)


def test_points_of_pixels_project_back_to_their_centres():
    """Of a camera that is turned about all its axes: x = R p + t, then K x / z at depth z."""
    R = torch.from_numpy(Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix())
    K = torch.tensor([[70.0, 0, 30.5], [0, 90.0, 21.0], [0, 0, 1]]).double()
    view = CameraView(R, torch.tensor([0.2, -0.4, 1.5]).double(), K, 60, 40)
    row, column = torch.tensor([0, 7, 39]), torch.tensor([59, 3, 0])
    depth = torch.tensor([0.5, 1.2, 3.0]).double()
    seen = points_of_pixels(row, column, depth, view) @ R.T + view.t
    np.testing.assert_allclose(seen[:, 2], depth, rtol=ROUNDING)
    pixels = (seen @ K.T)[:, :2] / seen[:, 2:]
    np.testing.assert_allclose(pixels, np.stack([column + 0.5, row + 0.5], 1), rtol=ROUNDING)


@pytest.mark.parametrize("source", SOURCES)
def test_where_nothing_is_drawn_depth_is_zero(source):
    gaussians, mesh = sphere(0.95)
    gaussians["opacities"] = torch.zeros(len(gaussians["means"]))
    _, depth, _ = seen(gaussians, (mesh[0] + 5, mesh[1]), source)
    assert not depth.any()


@pytest.mark.parametrize(
    ("source", "nearest", "farthest"),
    [("expected", 0.4, 1.0), ("normalised", 0.0, 0.3), ("median", 0.0, 0.3), ("traced", 0.0, 0.3)],
)
def test_avatar_puts_the_glint_of_a_sheet_where_the_mirror_law_does(source, nearest, farthest):
    """All of the view: on a plane the mirror point divides the feet of camera and light by their heights. Alpha is 0.98
    at the start of a training: already too little for a depth that is not divided by it."""
    sheet = make_sheet(48)
    spec = AvatarSpec(specular=True, shadow=False, shadow_width=4, supersample=2, dilation_px2=0.1, depth=source)
    avatar = Avatar(sheet, texel_spacing(sheet), spec)
    light = np.array([0.25, 0.15, 0.6])
    with torch.no_grad():
        avatar.albedo.zero_()
        avatar.log_roughness.fill_(np.log(SIGMA))
        frame = avatar.prepare(FrameInputs(sheet, make_frame(sheet, light[None], np.ones((1, 3)))))
        rgb = avatar.view(frame, VIEW).rgb
    expected = CAMERA.project((light * 1.2 + CAMERA.center * 0.6) / 1.8 * [1, 1, 0])[0]
    assert nearest <= np.linalg.norm(glint_pixel(rgb.sum(-1).numpy()) - expected) < farthest
