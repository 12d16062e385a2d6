"""Mirror balls: reflections against a search for the shortest path, outlines against the ball's tangent cone and images
drawn by counting samples per pixel.
"""

import numpy as np
import pytest

from pipeline.calibration.lights.ball_images import measure_outline, why_no_ball
from pipeline.calibration.lights.length_units import radius_in_rig
from pipeline.calibration.lights.mirror_ball import (
    locate_ball,
    reflected_rays,
    reflection_derivatives,
    reflection_points,
)
from pipeline.geometry.cameras import Camera

RADIUS = 0.18
SIZE = (320, 320)


def camera_at(center, target=(0, 0, 0), dist=(-0.05, 0.02, 1e-3, -1e-3, 0.0)):
    center = np.asarray(center, float)
    forward = (np.asarray(target, float) - center) / np.linalg.norm(np.asarray(target, float) - center)
    right = np.cross(forward, [0, -1.0, 0]) * -1
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[560.0, 0, 158], [0, 561, 163], [0, 0, 1]])
    return Camera(R, -R @ center, K, np.array(dist), *SIZE)


CAMERAS = [camera_at([0, 0.2, 2.5]), camera_at([2.3, 0.1, -0.6]), camera_at([-1.8, 0.4, -1.7])]
BALLS = np.array([[0.05, 0.02, -0.03], [-0.15, 0.2, 0.1]])


def planted_lights(count, rng):
    lights = rng.normal(size=(count, 3))
    return 2.4 * lights / np.linalg.norm(lights, axis=1, keepdims=True)


def searched_highlight(ball, camera_center, light):
    """The point of the sphere whose path camera - point - light is shortest (Fermat), by shrinking random search."""
    rng = np.random.default_rng(0)
    best, width = (camera_center - ball) / np.linalg.norm(camera_center - ball), 2.0
    length = np.inf
    while width > 1e-9:
        tries = best + width * rng.normal(size=(400, 3))
        tries = np.concatenate([best[None], tries / np.linalg.norm(tries, axis=1, keepdims=True)])
        points = ball + RADIUS * tries
        paths = np.linalg.norm(points - camera_center, axis=1) + np.linalg.norm(points - light, axis=1)
        # Seen from the camera and lit: outside both tangent planes.
        lit = (((camera_center - points) * tries).sum(1) > 0) & (((light - points) * tries).sum(1) > 0)
        k = np.argmin(np.where(lit, paths, np.inf))
        best, length, width = tries[k], min(length, paths[k]), width * 0.6
    return ball + RADIUS * best


def outline(ball, camera, count=200):
    """Pixels of the circle in which the cone from the camera touches the sphere."""
    toward = ball - camera.center
    distance = np.linalg.norm(toward)
    axis = toward / distance
    u = np.cross(axis, [0.3, 1, 0.2])
    u /= np.linalg.norm(u)
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)[:, None]
    ring = np.cos(angle) * u + np.sin(angle) * np.cross(axis, u)
    touching = ball - axis * RADIUS**2 / distance + ring * RADIUS * np.sqrt(1 - (RADIUS / distance) ** 2)
    return camera.project(touching)[0]


def drawn(covered, oversampling=4):
    """An image from a function of pixel positions, averaged over each pixel."""
    width, height = SIZE
    steps = (np.arange(oversampling * width) + 0.5) / oversampling
    x, y = np.meshgrid(steps, steps[: oversampling * height])
    samples = covered(np.stack([x.ravel(), y.ravel()], 1)).reshape(height, oversampling, width, oversampling)
    return samples.mean((1, 3)).astype(np.float32)


def hits(ball, camera):
    """Whether the rays through pixels hit the ball."""

    def covered(pixels):
        ray = camera.ray_directions(pixels)
        toward = ball - camera.center
        return (ray @ toward) ** 2 > toward @ toward - RADIUS**2

    return covered


@pytest.mark.parametrize("seed", range(4))
def test_reflection_point_is_the_shortest_path(seed):
    rng = np.random.default_rng(seed)
    light = planted_lights(1, rng)
    camera = CAMERAS[seed % 3].center
    found = reflection_points(BALLS[:1], RADIUS, camera[None], light)[0]
    # Fermat's path is flat at its minimum: lengths to 1e-16 give points to 1e-8.
    assert found == pytest.approx(searched_highlight(BALLS[0], camera, light[0]), abs=1e-6)


def test_reflection_obeys_the_mirror_law_everywhere():
    rng = np.random.default_rng(5)
    camera = CAMERAS[0].center
    lights = np.concatenate([planted_lights(200, rng), [camera, 2 * camera, 0.5 * (camera + BALLS[0])]])
    n = len(lights)
    points = reflection_points(np.tile(BALLS[0], (n, 1)), RADIUS, np.tile(camera, (n, 1)), lights)
    normal = (points - BALLS[0]) / RADIUS
    assert np.linalg.norm(normal, axis=1) == pytest.approx(np.ones(n))
    toward = [(target - points) / np.linalg.norm(target - points, axis=1, keepdims=True) for target in (camera, lights)]
    half = toward[0] + toward[1]
    # Lights in the ball's shadow as seen from the camera have no highlight: there both cosines are not positive.
    seen = (toward[0] * normal).sum(1) > 1e-6
    assert seen.sum() > 190
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    assert half[seen] == pytest.approx(normal[seen], abs=1e-7)


def test_reflected_rays_pass_through_the_light():
    lights = planted_lights(50, np.random.default_rng(6))
    points = reflection_points(np.tile(BALLS[0], (50, 1)), RADIUS, np.tile(CAMERAS[1].center, (50, 1)), lights)
    seen = ((CAMERAS[1].center - points) * (points - BALLS[0])).sum(1) > 1e-3
    on_ball, direction = reflected_rays(BALLS[0], RADIUS, CAMERAS[1], CAMERAS[1].project(points[seen])[0])
    assert on_ball == pytest.approx(points[seen], abs=1e-6)
    distance = np.linalg.norm(np.cross(lights[seen] - on_ball, direction), axis=1)
    assert distance.max() < 1e-4  # undistortion stops at 1e-12, multiplied by the rim's magnification
    missing = reflected_rays(BALLS[0], RADIUS, CAMERAS[1], np.array([[1.0, 1.0]]))[1]
    assert np.isnan(missing).all()


@pytest.mark.parametrize("cameras", [[0], [0, 1, 2]])
def test_ball_from_exact_outlines(cameras):
    ball = locate_ball([CAMERAS[c] for c in cameras], [outline(BALLS[1], CAMERAS[c]) for c in cameras], RADIUS)
    assert ball.center == pytest.approx(BALLS[1], abs=1e-7)
    assert ball.rms_px < 1e-5


def test_radius_of_a_ball_is_that_of_its_tangent_cones():
    """Two positions in three cameras; a third position that a single camera sees says nothing of its size."""
    cameras = {str(number): camera for number, camera in enumerate(CAMERAS)}
    seen = {(place, name): outline(BALLS[int(place)], cameras[name]) for place in "01" for name in cameras}
    alone = {("2", "0"): outline(BALLS[0], cameras["0"])}
    assert radius_in_rig(cameras, seen | alone) == pytest.approx(RADIUS, rel=1e-6)
    assert radius_in_rig(cameras, alone) is None


def test_ball_with_noise_and_a_hidden_part():
    rng = np.random.default_rng(0)
    outlines = [outline(BALLS[0], camera) + rng.normal(0, 0.2, (200, 2)) for camera in CAMERAS]
    outlines[0][:40] += [3.0, 0.0]  # a fifth of one outline belongs to a stand
    ball = locate_ball(CAMERAS, outlines, RADIUS)
    sigma = np.sqrt(np.diag(ball.covariance))
    # One camera alone: 0.2 px / 560 px * 2.5 m / sqrt(100) across = 0.09 mm; the stand pulls its camera's centre aside,
    # which the others contradict: three times as much.
    assert sigma.max() < 4e-4
    assert np.abs(ball.center - BALLS[0]).max() < 5 * sigma.max()


@pytest.mark.parametrize("camera", CAMERAS)
def test_outline_in_a_drawn_image(camera):
    image = 0.7 - 0.67 * drawn(hits(BALLS[0], camera))
    image += np.random.default_rng(1).normal(0, 0.01, image.shape).astype(np.float32)
    found = measure_outline(image)
    assert len(found) == 360
    ball = locate_ball([camera], [found], RADIUS)
    error = ball.center - BALLS[0]
    along = (BALLS[0] - camera.center) / np.linalg.norm(BALLS[0] - camera.center)
    # 4 x 4 samples per pixel: edges to 0.1 px, averaged over 360 points. Across: 2.5 m / 560 px * 0.1 / sqrt(180);
    # along: the ball's radius of 40 px to 0.1 / sqrt(360) px is 1.3e-4 of 2.5 m. Times 5.
    assert abs(error @ along) < 5 * 2.5 * 1.3e-4
    assert np.linalg.norm(error - error @ along * along) < 5 * 3.3e-5


def test_no_ball_is_none():
    rng = np.random.default_rng(2)
    assert measure_outline(rng.uniform(0.6, 0.7, (100, 100)).astype(np.float32)) is None
    cut = drawn(hits(np.array([0.75, 0.0, 0.0]), CAMERAS[0]))
    assert cut.any()
    assert measure_outline(0.7 - 0.6 * cut) is None
    assert why_no_ball(0.7 - 0.6 * cut) == "a ball that touches the image's border"
    square = np.full((100, 100), 0.7, np.float32)
    square[30:70, 30:70] = 0.05
    assert measure_outline(square) is None
    assert why_no_ball(square) == "no round dark disc before a bright backdrop"
    # A dark wall at the border is no ball that is cut off.
    square[:, :20] = 0.05
    assert why_no_ball(square) == "no round dark disc before a bright backdrop"


def test_derivatives_are_those_of_the_reflection():
    rng = np.random.default_rng(8)
    lights = planted_lights(40, rng)
    ball, camera = np.tile(BALLS[0], (40, 1)), np.tile(CAMERAS[0].center, (40, 1))
    points = reflection_points(ball, RADIUS, camera, lights)
    by_ball, by_light = reflection_derivatives(ball, RADIUS, camera, lights, points)
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        light = reflection_points(ball, RADIUS, camera, lights + step)
        light -= reflection_points(ball, RADIUS, camera, lights - step)
        moved = reflection_points(ball + step, RADIUS, camera, lights)
        moved -= reflection_points(ball - step, RADIUS, camera, lights)
        # Central differences: truncation 1e-10, rounding 1e-16 / 1e-5.
        assert by_light[:, :, axis] == pytest.approx(light / 2e-5, abs=1e-9)
        assert by_ball[:, :, axis] == pytest.approx(moved / 2e-5, abs=1e-9)


def test_cameras_that_disagree_widen_the_covariance():
    rng = np.random.default_rng(0)
    outlines = [outline(BALLS[0], camera) + rng.normal(0, 0.1, (200, 2)) for camera in CAMERAS]
    alike = locate_ball(CAMERAS, outlines, RADIUS)
    assert alike.disagreement == 1.0
    shifted = [outlines[0] + [0.5, 0.0], *outlines[1:]]  # one camera is turned by half a pixel
    apart = locate_ball(CAMERAS, shifted, RADIUS)
    assert apart.disagreement > 5
    error = apart.center - BALLS[0]
    assert error @ np.linalg.solve(apart.covariance, error) < 16  # chi^2 of three exceeds it once in a thousand
    assert error @ np.linalg.solve(alike.covariance, error) > 16
