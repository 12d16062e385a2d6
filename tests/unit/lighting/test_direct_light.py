"""Direct light on a matte floor under a square that hangs above it, against the inverse square law by hand."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.surface_points import SurfacePoints
from pipeline.lighting.direct_light import direct_light
from pipeline.lighting.frame_lights import FrameLights
from tests.support.meshes.lit_meshes import plate, together

HALF, HEIGHT = 0.5, 1.0
"""The square's, metres."""

EDGE_M = 0.01
"""Points nearer to a shadow's edge are left out: rays start a little above the floor."""


def test_each_lamp_adds_its_own_unless_the_square_hides_it() -> None:
    vertices, faces = together(plate(9.0, 0.0), plate(HALF, HEIGHT))
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], 4000)
    surface = SurfacePoints(faces[np.arange(4000) % 2], weights)
    points = surface.carried(vertices)
    lamps = np.array([[0.3, 4.0, 0.1], [-2.0, 3.0, 1.0]])
    colors = np.array([[1.0, 2.0, 3.0], [5.0, 1.0, 0.5]])
    up = np.tile([0.0, 1.0, 0.0], (len(points), 1))
    found = direct_light(vertices, faces.astype(np.int64), surface, up, FrameLights(lamps, colors))
    expected, clear, hidden = np.zeros(len(points)), np.ones(len(points), bool), 0
    for lamp, luminance in zip(lamps, colors @ [0.2126, 0.7152, 0.0722], strict=True):
        way = lamp - points
        crossing = points + HEIGHT / lamp[1] * way  # on the square's plane
        inside = np.abs(crossing[:, [0, 2]]).max(1) - HALF
        distance = np.linalg.norm(way, axis=1)
        expected += (inside > 0) * luminance * way[:, 1] / distance**3
        clear &= np.abs(inside) > EDGE_M
        hidden += np.count_nonzero(inside < 0)
    assert clear.mean() > 0.95 and hidden > 20
    np.testing.assert_allclose(found[clear], expected[clear], rtol=1e-5, atol=1e-9)
