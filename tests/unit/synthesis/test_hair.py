"""Strands of hair: where they grow, how thick they are, and that pictures show them above the skull."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.hair import DEPTH_M, RADIUS_M, ROOT_M, grow, skull, tubes
from pipeline.synthesis.head_appearance import hair_share
from pipeline.synthesis.head_shape import head_field, head_mesh
from pipeline.synthesis.subject import Strands

COUNT = 400


@pytest.fixture(scope="module")
def skin():
    return head_mesh(0.009)


@pytest.fixture(scope="module")
def strands(skin):
    return grow("someone", COUNT, *skin)


def test_strands_start_below_the_skull_and_end_about_the_template(skin, strands):
    vertices, faces = skin
    share, moved = hair_share(vertices), np.linalg.norm(skull(vertices, faces) - vertices, axis=1)
    np.testing.assert_allclose(moved, DEPTH_M * share, atol=1e-12)
    # Half of the strands and more have the whole layer above their skull; it thins out at the hair line.
    roots = head_field(strands[:, 0])
    assert np.median(roots) == pytest.approx(-DEPTH_M - ROOT_M, abs=0.05 * DEPTH_M) and roots.max() < 0
    # The field is a distance to first order: a tenth is left for its curvature.
    tips = head_field(strands[:, -1])
    assert abs(np.median(tips)) < DEPTH_M / 2 and tips.max() < 1.5 * DEPTH_M
    # Roots stand where hair grows: at a vertex in reach of their triangle there is some.
    around = [share[near].max() for near in cKDTree(vertices).query_ball_point(strands[:, 1], 0.02)]
    assert np.min(around) > 0.5


def test_equal_names_give_equal_hair_and_others_give_other(skin, strands):
    np.testing.assert_array_equal(grow("someone", COUNT, *skin), strands)
    assert np.abs(grow("another", COUNT, *skin) - strands).max() > 0.01


def test_tubes_have_the_radius_around_straight_strands_and_face_outward():
    """A strand along each axis and one along the diagonal."""
    ways = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1] / np.sqrt(3)])
    points = 0.01 * np.arange(5)[None, :, None] * ways[:, None]
    vertices, normals, faces = tubes(Strands(points, RADIUS_M))
    owner = np.arange(len(vertices)) // (len(vertices) // 4)
    aside = vertices - (vertices * ways[owner]).sum(1, keepdims=True) * ways[owner]
    np.testing.assert_allclose(np.linalg.norm(aside, axis=1), RADIUS_M, rtol=1e-9)
    np.testing.assert_allclose(normals, aside / RADIUS_M, atol=1e-9)
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((across * normals[faces].mean(1)).sum(1) > 0).all()


def test_head_with_hair_is_photographed_above_a_deeper_skull_and_tracked_as_before():
    from pipeline.stages.synthesize_capture import build_subject

    asked = SynthesizeCapture(figure="head", vertex_spacing_m=0.012, texture_size=64)
    bald, haired = (
        build_subject("someone", asked.model_copy(update={"hair_strands": count})).at(0.4, "a") for count in (0, 50)
    )
    np.testing.assert_array_equal(bald.vertices, haired.vertices)
    np.testing.assert_array_equal(bald.keypoints, haired.keypoints)
    assert bald.strands is None and bald.photographed is None
    moved = np.linalg.norm(haired.photographed - haired.vertices, axis=1)
    assert moved.max() == pytest.approx(DEPTH_M, rel=0.02) and np.median(moved) < 0.1 * DEPTH_M
    assert haired.strands.points.shape[0] == 50
    # Strands turn with the head: what is nearest to them is skin that was moved in, not the face.
    nearest = cKDTree(haired.vertices).query(haired.strands.points[:, 1])[1]
    assert (moved[nearest] > 0.5 * DEPTH_M).mean() > 0.8
