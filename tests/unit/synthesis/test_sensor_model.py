"""Noise, colour and files of the sensor against what is configured."""

import numpy as np
import OpenEXR
import pytest

from pipeline.base.exr import save_exr
from pipeline.synthesis.sensor_model import SensorModel, write_8bit

MODEL = SensorModel(shot_gain=2e-4, read_noise=0.002, saturation=1.0, black_level=0.05)

PIXELS = 200
SPREAD_TOLERANCE = 5 / np.sqrt(2 * 3 * PIXELS**2)
"""Five standard errors of a standard deviation estimated from 3 * PIXELS^2 samples, relative."""


@pytest.mark.parametrize("signal", [0.0, 0.1, 0.6])
def test_noise_is_shot_plus_read(signal):
    radiance = np.full((PIXELS, PIXELS, 3), signal, dtype=np.float32)
    raw = MODEL.expose(radiance, np.eye(3), np.random.default_rng(1))
    expected = np.sqrt(2e-4 * signal + 0.002**2)
    assert raw.std() == pytest.approx(expected, rel=SPREAD_TOLERANCE)
    assert raw.mean() == pytest.approx(signal + 0.05, abs=5 * expected / np.sqrt(3 * PIXELS**2))


def test_color_response_is_applied_to_true_colors():
    response = np.array([[1.1, 0.05, 0], [0.02, 0.9, 0], [0, 0.1, 1.0]])
    quiet = SensorModel(0.0, 0.0, 10.0, 0.0)
    raw = quiet.expose(np.full((1, 1, 3), [0.2, 0.4, 0.6], dtype=np.float32), response, np.random.default_rng(0))
    np.testing.assert_allclose(raw[0, 0], response @ [0.2, 0.4, 0.6], rtol=1e-6)


def test_saturation_comes_before_the_black_level():
    quiet = SensorModel(0.0, 0.0, 1.0, 0.1)
    raw = quiet.expose(np.full((1, 1, 3), 7.0, dtype=np.float32), np.eye(3), np.random.default_rng(0))
    np.testing.assert_allclose(raw, 1.1, rtol=1e-6)


def test_exr_is_half_and_lossless(tmp_path):
    image = np.random.default_rng(0).uniform(-0.01, 1, (7, 5, 3)).astype(np.float32)
    save_exr(tmp_path / "a" / "b.exr", image)
    with OpenEXR.File(str(tmp_path / "a" / "b.exr")) as file:
        pixels = file.channels()["RGB"].pixels
    assert pixels.dtype == np.float16
    np.testing.assert_array_equal(pixels, image.astype(np.float16))


def test_unwritable_picture_is_an_error(tmp_path):
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(OSError, match="taken"):
        write_8bit(tmp_path / "taken.png", np.zeros((4, 4), dtype=np.uint8))
