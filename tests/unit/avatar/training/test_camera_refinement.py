"""Poses of cameras: found where images tell them, left alone where they do not."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.avatar.frames.camera_offsets import CAMERAS_AS_CALIBRATED, CameraOffsets
from pipeline.avatar.training.camera_refinement import refined_cameras
from pipeline.avatar.training.light_refinement import Sigmas
from pipeline.avatar.training.picture_equations import PictureEquations, image_equations
from pipeline.avatar.training.seen_surface import seen_surface
from tests.support.avatars.sheet import SIDE_M, make_frame, make_image, make_sheet

SIGMAS = Sigmas(turn=1e-3, shift_m=2e-3)

MOTION = np.array([4e-4, -3e-4, 5e-4, 5e-4, 1e-3, -1e-3])
"""Turn and shift of a camera, as large as a poor calibration's; a fifth of a pixel of the picture."""

CYCLES_PER_M = 12.0
"""Of the painted waves: eight pixels long, so that slopes of the picture tell its motion."""


def painted(image):
    """The picture of a sheet of waves from where the camera of an image stands: each ray's point on z = 0."""
    pixels = np.mgrid[: image.height, : image.width][::-1] + 0.5
    K = image.K
    rays = np.stack([(pixels[0] - K[0, 2]) / K[0, 0], (pixels[1] - K[1, 2]) / K[1, 1], np.ones(pixels[0].shape)], -1)
    ways, center = rays @ image.R, -image.R.T @ image.t
    points = center - ways * (center[2] / ways[..., 2:])
    x, y = 2 * np.pi * CYCLES_PER_M * points[..., 0], 2 * np.pi * CYCLES_PER_M * points[..., 1]
    waves = np.stack([np.sin(x), np.sin(y), np.sin(x + y)], -1)
    return (0.4 + 0.1 * waves) * (np.abs(points[..., :2]) < SIDE_M / 2).all(-1)[..., None]


@pytest.fixture(scope="module")
def views():
    """A camera of its own for each name, looking at the sheet askew, and the surface that it sees."""
    sheet = make_sheet(8)
    image = make_image(make_frame(sheet, np.array([[0.5, 0.3, 1.5]]), np.ones((1, 3))), np.ones(3), pixels=64)
    askew = []
    for name, turn in (("left", [0.1, 0.5, 0.0]), ("right", [-0.2, -0.6, 0.1])):
        R = Rotation.from_rotvec(turn).as_matrix() @ image.R
        view = dataclasses.replace(image, camera=name, R=R, t=np.array([0.0, 0.0, 1.0]))
        whole = dataclasses.replace(view, mask=(painted(view).sum(-1) > 0).astype(np.float32))
        askew.append((whole, seen_surface(whole, sheet.rest_vertices.astype(np.float64), sheet.faces.astype(np.int64))))
    return askew


def test_change_of_a_picture_by_its_cameras_motion_is_the_difference_of_two(views):
    image, surface = views[0]
    columns = surface.motion_columns(painted(image))
    assert surface.seen.sum() > 300
    for axis, column in enumerate(np.moveaxis(columns, -1, 0)):
        step = 1e-4 * np.eye(6)[axis]
        after, before = (painted(CameraOffsets(["left"], sign * step[None]).moved(image)) for sign in (1, -1))
        wanted = ((after - before) / 2e-4)[surface.seen]
        # Slopes are central differences of waves eight pixels long: sin(2 pi / 8) / (2 pi / 8) = 0.90 of theirs, the
        # diagonal ones and those seen askew less.
        share = (column * wanted).sum() / (wanted**2).sum()
        assert 0.75 < share < 1.0
        np.testing.assert_allclose(column, share * wanted, atol=0.15 * np.abs(wanted).max())


def equations(image, surface, captured):
    rendered, seen = painted(image), surface.seen
    columns = np.moveaxis(surface.motion_columns(rendered), -1, 0)
    return image_equations(columns, rendered[seen], captured[seen])


def test_planted_motion_is_found_and_undone(views):
    rng, cameras = np.random.default_rng(0), {}
    planted = CameraOffsets([image.camera for image, _ in views], np.stack([MOTION, -MOTION]))
    for image, surface in views:
        cameras[image.camera] = PictureEquations.none(6)
        for half in range(2):
            truth = painted(planted.moved(image)) + rng.normal(0, 2e-3, (64, 64, 3))
            cameras[image.camera].add(half, *equations(image, surface, truth))
    found, share = refined_cameras(cameras, SIGMAS)
    assert share > 0.5
    for image, surface in views:
        wanted, before, after = (painted(each.moved(image)) for each in (planted, CAMERAS_AS_CALIBRATED, found))
        errors = [np.abs(picture - wanted)[surface.seen].mean() for picture in (before, after)]
        assert errors[1] < 0.25 * errors[0]  # a tenth is left of slopes that are too flat by a tenth, and of noise
    again = CameraOffsets.from_json(json.loads(json.dumps(found.as_json())))
    np.testing.assert_array_equal(again.moved(views[0][0]).t, found.moved(views[0][0]).t)
    assert found.moved(stranger := dataclasses.replace(views[0][0], camera="other")) is stranger


def test_cameras_stay_where_halves_contradict_each_other_or_little_is_gained(views):
    image, surface = views[0]
    there, back = (CameraOffsets(["left"], sign * MOTION[None]).moved(image) for sign in (1, -1))
    against = PictureEquations.none(6)
    for half, camera in enumerate((there, back)):
        against.add(half, *equations(image, surface, painted(camera)))
    offsets, share = refined_cameras({"left": against}, SIGMAS)
    assert offsets is CAMERAS_AS_CALIBRATED and share < 0
    noise = PictureEquations.none(6)
    rng = np.random.default_rng(2)
    for half in range(2):
        seen = painted(CameraOffsets(["left"], 0.01 * MOTION[None]).moved(image)) + rng.normal(0, 5e-3, (64, 64, 3))
        noise.add(half, *equations(image, surface, seen))
    assert refined_cameras({"left": noise}, SIGMAS)[0] is CAMERAS_AS_CALIBRATED
