"""Grey calibration images of every kind of file."""

import cv2
import numpy as np
import pytest

from pipeline.base.exr import write_exr
from pipeline.capture.gray import read_gray, read_gray_8bit


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
def test_counts_are_divided_by_their_maximum(tmp_path, dtype, top):
    stored = np.array([[0, top], [top // 5, top]], dtype)
    cv2.imwrite(str(tmp_path / "gray.png"), stored)
    assert read_gray(tmp_path / "gray.png") == pytest.approx(stored / top)
    assert np.array_equal(read_gray_8bit(tmp_path / "gray.png"), [[0, 255], [51, 255]])


def test_colour_is_averaged(tmp_path):
    stored = np.full((4, 5, 3), (30, 60, 90), np.uint8)
    cv2.imwrite(str(tmp_path / "color.png"), stored)
    assert np.all(read_gray_8bit(tmp_path / "color.png") == 60)


def test_linear_floats_are_brightened(tmp_path):
    image = np.full((20, 20, 3), 0.01, np.float32)
    image[:10] = 0.04
    image[0, 0] = 1000.0
    write_exr(tmp_path / "image.exr", image)
    gray = read_gray_8bit(tmp_path / "image.exr")
    assert gray[5, 5] == 255
    assert gray[15, 5] == pytest.approx(128, abs=1)
