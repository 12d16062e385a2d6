"""Two-sphere eyes: their surface, and that a photographed glint lies where light takes the shortest way."""

import numpy as np
import pytest
import scipy.optimize
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.eyeball import (
    CORNEA_OFFSET_M,
    CORNEA_RADIUS_M,
    EYE_CENTERS_M,
    EYE_NAMES,
    EYE_RADIUS_M,
    LIMBUS_RADIUS_M,
    LIMBUS_Z_M,
    cornea_patch,
    eye_directions,
    eye_uv,
    radius_along,
    sclera_patch,
    template_eyeball,
)
from pipeline.synthesis.head import build_head
from pipeline.synthesis.lens import view_points
from pipeline.synthesis.stage_rig import look_at

ROUNDING_M = 1e-15
"""A few roundings of centimetres."""

PIXEL_M, FINER = 0.0022, 8
"""A pixel of subjectB's images at the eye, and pixels of these tests in it along one axis."""

CLEAR_M = 0.0005
"""Height of a glint's middle above the limbus from which on its core is whole, 0.4 mm in radius."""

TOLERANCE_PX = 0.05
"""Of subjectB's pixels, 0.1 mm: the core of a lobe 0.05 wide reaches 0.4 mm from its middle, and what it reflects falls
off by a few per cent over that (the Fresnel term, the distance), which moves its middle by about as much of it."""


def outside(points):
    """Distance to the union of the two spheres, for points outside it; negative inside."""
    cornea = np.linalg.norm(points - [0, 0, CORNEA_OFFSET_M], axis=1) - CORNEA_RADIUS_M
    return np.minimum(np.linalg.norm(points, axis=1) - EYE_RADIUS_M, cornea)


def test_surface_is_that_of_the_union_in_every_direction():
    directions = np.random.default_rng(0).normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radius = radius_along(directions)
    np.testing.assert_allclose(outside(radius[:, None] * directions), 0, atol=10 * ROUNDING_M)
    np.testing.assert_allclose(radius_along(np.array([[0.0, 0, 1], [0, 0, -1], [1, 0, 0]])), [
        CORNEA_OFFSET_M + CORNEA_RADIUS_M, EYE_RADIUS_M, EYE_RADIUS_M,
    ])  # fmt: skip
    assert (radius > 1.02 * EYE_RADIUS_M).any()


def test_templates_eye_is_closed_and_turns_about_its_mean():
    vertices, faces = template_eyeball()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.volume > 0
    np.testing.assert_allclose(outside(vertices), 0, atol=10 * ROUNDING_M)
    np.testing.assert_allclose(vertices[0], [0, 0, CORNEA_OFFSET_M + CORNEA_RADIUS_M], atol=10 * ROUNDING_M)
    assert np.linalg.norm(vertices.mean(0)) < 1e-4


def test_patches_lie_on_their_spheres_and_meet_in_the_limbus():
    for patch, radius, offset in (
        (cornea_patch(), CORNEA_RADIUS_M, CORNEA_OFFSET_M),
        (sclera_patch(), EYE_RADIUS_M, 0),
    ):
        np.testing.assert_allclose(patch.vertices, radius * patch.normals + [0, 0, offset], atol=ROUNDING_M)
        corners = patch.vertices[patch.faces]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((outward * patch.normals[patch.faces].mean(1)).sum(1) > 0).all()
    both = np.concatenate([cornea_patch().vertices, sclera_patch().vertices])
    np.testing.assert_allclose(outside(both), 0, atol=10 * ROUNDING_M)
    rim = sclera_patch().vertices[:96]
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), LIMBUS_RADIUS_M, rtol=1e-12)
    np.testing.assert_allclose(cornea_patch().vertices[-96:], rim, atol=10 * ROUNDING_M)


def test_texels_show_the_direction_that_looks_them_up():
    size = 32
    directions = eye_directions(size)
    v, u = (np.mgrid[:size, :size].reshape(2, -1) + 0.5) / size
    inside = np.hypot(2 * u - 1, 2 * v - 1) < 1
    found = eye_uv(radius_along(directions)[:, None] * directions)
    np.testing.assert_allclose(found[inside], np.stack([u, v], 1)[inside], atol=1e-12)
    np.testing.assert_allclose(directions[~inside], np.array([0, 0, -1]) * np.ones(((~inside).sum(), 1)), atol=1e-12)


def shortest_way(center, radius, camera, light):
    """The point of a sphere over which light takes the shortest way (Fermat), found by a general minimiser."""

    def length(angles):
        normal = np.array(
            [np.cos(angles[0]) * np.sin(angles[1]), np.sin(angles[0]), np.cos(angles[0]) * np.cos(angles[1])]
        )
        point = center + radius * normal
        return np.linalg.norm(camera - point) + np.linalg.norm(light - point)

    found = scipy.optimize.minimize(length, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-15})
    y, x = found.x
    return center + radius * np.array([np.cos(y) * np.sin(x), np.sin(y), np.cos(y) * np.cos(x)])


@pytest.fixture(scope="module")
def head():
    return build_head("test", 0.03, 64, 0.3)


def photographed_glint(head, light, time_s):
    """A camera, the left eye's centre and gaze in the world, and the middle of its cornea's glint in the picture.

    The picture is eight times finer than subjectB's. The eye is painted black, and its white has no coat: the
    glint there, which lies elsewhere, would be seen as well.
    """
    moment = head.at(time_s, "a")
    root = Rotation.from_quat(moment.truth["root_rotation"], scalar_first=True)
    center = root.apply(EYE_CENTERS_M[0]) + moment.truth["root_translation"]
    place = np.array([0.25, 0.1, 1.2])
    R = look_at(place, center, roll=0.1)
    focal = FINER * 1.2 / PIXEL_M
    K = np.array([[focal, 0, 63.3], [0, 1.004 * focal, 65.8], [0, 0, 1]])
    camera = Camera(R, -R @ place, K, np.array([-0.06, 0.02, 0.001, 0.001, 0.0]), 128, 128)
    black = np.zeros((2, 2, 3), np.float32)
    cornea, sclera = (surface for surface in moment.surfaces if surface.name == EYE_NAMES[0])
    meshes = [
        scenes.coated_mesh(
            black, cornea.gloss_alpha, cornea.vertices, cornea.normals, cornea.faces, cornea.uv, cornea.ior
        ),
        scenes.triangle_mesh({"type": "diffuse", "reflectance": 0.0}, sclera.vertices, sclera.faces, sclera.uv),
    ]
    view = view_points(camera, sclera.vertices, 1)
    scene = scenes.lit_scene(meshes, light[None], np.array([5.0]), max_depth=2)
    image = view.develop(scenes.render(scene, view, 64, seed=1))[..., 1].astype(np.float64)
    rows, columns = np.mgrid[:128, :128] + 0.5
    core = np.where(image > 0.5 * image.max(), image, 0.0)
    middle = np.array([(columns * core).sum(), (rows * core).sum()]) / core.sum()
    return camera, center, root.apply(moment.gaze[EYE_NAMES[0]]), middle


@pytest.mark.parametrize("light", [[0.3, 0.2, 1.3], [-0.6, 0.2, 1.1], [0.5, -0.3, 0.9]])
@pytest.mark.parametrize("time_s", [0.0, 0.3, 0.9])
def test_glint_on_the_cornea_lies_where_the_mirror_law_puts_it(head, light, time_s):
    pytest.importorskip("mitsuba")
    camera, center, gaze, middle = photographed_glint(head, np.array(light), time_s)
    point = shortest_way(center + CORNEA_OFFSET_M * gaze, CORNEA_RADIUS_M, camera.center, np.array(light))
    assert (point - center) @ gaze > LIMBUS_Z_M + CLEAR_M, "the case has its glint on the limbus: choose another"
    pixel, _ = camera.project(point[None])
    assert np.linalg.norm(middle - pixel[0]) / FINER < TOLERANCE_PX
