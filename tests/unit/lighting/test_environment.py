"""Environment maps against closed forms and against Mitsuba's own reading of the same panorama."""

from __future__ import annotations

from pathlib import Path

import cv2
import mitsuba
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.lighting.environment import Environment, read_environment
from pipeline.lighting.irradiance import Samples, trace_irradiance
from pipeline.lighting.light_scene import LUMINANCE, Lights
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from tests.support.meshes.lit_meshes import plate, sphere, together

UP = np.array([[0, 1.0, 0]])


def uniform(height: int) -> Environment:
    return Environment(np.ones((height, 2 * height, 3), np.float32))


def test_directions_and_solid_angles_cover_the_sphere() -> None:
    sky = uniform(16)
    np.testing.assert_allclose(np.linalg.norm(sky.directions(), axis=-1), 1, rtol=1e-12)
    assert sky.solid_angles().sum() * 32 == pytest.approx(4 * np.pi, rel=1e-12)
    corner = sky.directions()[8, 0]
    assert corner[2] < -0.98
    assert sky.directions()[8, 8, 0] > 0.98


def test_same_direction_as_mitsuba() -> None:
    """One bright pixel each: Mitsuba's environment map is brightest along our direction of that pixel."""
    mitsuba.set_variant("scalar_rgb")
    for row, column in [(3, 1), (8, 12), (12, 25), (6, 31)]:
        radiance = np.zeros((16, 32, 3), np.float32)
        radiance[row, column] = 1
        sky = Environment(radiance)
        emitter = mitsuba.load_dict({"type": "envmap", "bitmap": mitsuba.Bitmap(radiance)})
        directions = sky.directions().reshape(-1, 3)
        seen = []
        for direction in directions:
            interaction = mitsuba.SurfaceInteraction3f()
            interaction.wi = -mitsuba.Vector3f(direction)
            seen.append(emitter.eval(interaction)[0])
        # Mitsuba interpolates between pixels of a widened copy, so neighbours glow; ours must be the brightest.
        assert np.argmax(seen) == row * 32 + column


def test_half_space_and_ball_over_a_plane() -> None:
    """Without a cosine a floor sees half of all directions; a ball of angular radius a over its horizon hides the share
    (1 - cos a) / 2; weighted by the cosine (a Lambertian floor) it hides sin^2 a cos t, t being its angle from the
    zenith (Howell, B-43)."""
    sky, points = uniform(256).lights(), np.array([[0.3, 0, -0.2]])
    traced = trace_irradiance(Occluders(*plate(9, 0.0)), points, UP, sky)
    assert traced.values[0] == pytest.approx(0.5, abs=1e-3)
    assert traced.cosine_visibility[0] == pytest.approx(1.0, abs=1e-5)
    # Not in the zenith, where whole rows of pixels would be in or out together.
    radius, center = 0.7, (0.9, 2.0, 0.5)
    over = Occluders(*together(plate(9, 0.0), sphere(radius, center, 5)))
    traced = trace_irradiance(over, np.zeros((1, 3)), UP, sky)
    distance = np.linalg.norm(center)
    sine, cosine = radius / distance, center[1] / distance
    assert traced.values[0] == pytest.approx(np.sqrt(1 - sine**2) / 2, abs=1e-3)
    assert traced.cosine_visibility[0] == pytest.approx(1 - sine**2 * cosine, abs=1e-3)


def test_between_two_plates() -> None:
    """A square ceiling of half width w at height h hides, by the cosine, its form factor from the middle below
    (Howell, B-4, four corners): 4 / (2 pi) [a / sqrt(1 + a^2) atan(b / sqrt(1 + a^2)) + ...] with a = b = w / h; and
    without it the solid angle 4 asin(w^2 / (w^2 + h^2)) of the square (half angle form for a centred square)."""
    w, h = 1.5, 1.0
    between = Occluders(*together(plate(9, 0.0), plate(w, h)))
    traced = trace_irradiance(between, np.zeros((1, 3)), UP, uniform(256).lights())
    a = w / h
    factor = 4 / (2 * np.pi) * 2 * a / np.sqrt(1 + a * a) * np.arctan(a / np.sqrt(1 + a * a))
    assert traced.cosine_visibility[0] == pytest.approx(1 - factor, abs=1e-3)
    hidden = 4 * np.arcsin(w * w / (w * w + h * h))
    assert traced.values[0] == pytest.approx((2 * np.pi - hidden) / (4 * np.pi), abs=1e-3)


def test_drawing_pixels_by_their_light_is_unbiased() -> None:
    """A sky with a small sun: 4,000 independent points in one place have the exact sum as their mean, within 4 standard
    errors."""
    rng = np.random.default_rng(2)
    radiance = rng.random((16, 32, 3)).astype(np.float32)
    radiance[3, 5] = 300
    sky = Environment(radiance).lights()
    over = Occluders(*together(plate(9, 0.0), sphere(0.9, (0.5, 2, 0.2), 3)))
    exact = trace_irradiance(over, np.zeros((1, 3)), UP, sky).values[0]
    assert 0.05 < exact < 0.95
    texel = np.stack(np.divmod(np.arange(4000), 80), 1)
    here = np.zeros((4000, 3))
    drawn = trace_irradiance(
        over, here, np.repeat(UP, 4000, 0), sky, samples=Samples(1, "power", "random", TexelBlocks(texel), rng)
    ).values  # fmt: skip
    assert abs(drawn.mean() - exact) < 4 * drawn.std(ddof=1) / np.sqrt(4000)


def test_reduced_panorama_sends_the_same_light() -> None:
    rng = np.random.default_rng(1)
    sky = Environment(rng.random((64, 128, 3)).astype(np.float32))
    small = sky.reduced(16)
    assert small.radiance.shape == (16, 32, 3)
    np.testing.assert_allclose(small.irradiances().sum(0), sky.irradiances().sum(0), rtol=1e-6)
    assert sky.reduced(64) is sky
    assert sky.reduced(128) is sky
    with pytest.raises(ValueError, match="divides 64"):
        sky.reduced(48)


def test_files(tmp_path: Path) -> None:
    radiance = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32) * 4
    write_exr(tmp_path / "sky.exr", dict(zip("RGB", np.moveaxis(radiance, 2, 0), strict=True)))
    cv2.imwrite(str(tmp_path / "sky.hdr"), radiance[..., ::-1])
    for name, tolerance in (("sky.exr", 1e-3), ("sky.hdr", 1e-2)):  # half floats; one exponent per pixel, 8 bits
        read = read_environment(tmp_path / name).radiance
        np.testing.assert_allclose(read, radiance, atol=tolerance * 4)
    cv2.imwrite(str(tmp_path / "square.hdr"), radiance[:, :8])
    cv2.imwrite(str(tmp_path / "sky.png"), np.zeros((8, 16, 3), np.uint8))
    write_exr(tmp_path / "negative.exr", dict.fromkeys("RGB", -radiance[..., 0]))
    for name, message in [
        ("missing.hdr", "no such file"), ("square.hdr", "twice as wide"), ("sky.png", "in .hdr or .exr"),
        ("negative.exr", "0 or more"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=message):
            read_environment(tmp_path / name)


def test_lights_of_an_environment() -> None:
    sky = uniform(4)
    lights = sky.lights()
    assert isinstance(lights, Lights)
    assert lights.distant
    assert lights.luminances.sum() == pytest.approx(4 * np.pi * LUMINANCE.sum(), rel=1e-6)
