"""Images written by other libraries are read as they were meant, and cut ones not at all."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from pipeline.base.errors import InputError
from pipeline.base.exr import HALF_MAX, write_exr
from pipeline.capture.images import read_exr_channel, read_image, read_mask, read_stored, write_png
from tests.support.captures.builder import save_exr, truncate

RGB = np.random.default_rng(0).uniform(-0.1, 3, (5, 7, 3))


@pytest.mark.parametrize("names", ["RGB", "BGR", "GBR"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr_channels_go_by_name(names: str, dtype: type, tmp_path: Path) -> None:
    save_exr(tmp_path / "a.exr", RGB[..., ["RGB".index(name) for name in names]], names, dtype)
    image = read_image(tmp_path / "a.exr")
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, RGB.astype(dtype).astype(np.float32))


@pytest.mark.parametrize("compression", [OpenEXR.NO_COMPRESSION, OpenEXR.PIZ_COMPRESSION, OpenEXR.ZIPS_COMPRESSION])
def test_exr_of_other_compressions(compression, tmp_path: Path) -> None:
    planes = {name: np.ascontiguousarray(RGB[..., i].astype(np.float16)) for i, name in enumerate("RGB")}
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, planes).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), RGB.astype(np.float16).astype(np.float32))


def test_exr_black_level_is_subtracted_and_noise_stays_negative(tmp_path: Path) -> None:
    save_exr(tmp_path / "a.exr", RGB, dtype=np.float32)
    image = read_image(tmp_path / "a.exr", "linear", 0.25)
    np.testing.assert_allclose(image, RGB - 0.25, atol=1e-6)
    assert image.min() < 0


def test_png_of_8_bit_is_srgb_in_rgb_order(tmp_path: Path) -> None:
    """Pillow writes R, G, B; 188 of 255 is 0.5029 of the light (IEC 61966-2-1)."""
    Image.fromarray(np.array([[[255, 188, 0]]], np.uint8)).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_image(tmp_path / "a.png", "srgb", 0.0), [[[1, 0.5029, 0]]], atol=5e-5)


def test_png_that_is_a_plain_power_is_no_srgb(tmp_path: Path) -> None:
    """Half the light is stored as 0.5^(1 / 2.2), 186 of 255; near black the curve is not straight."""
    Image.fromarray(np.array([[[255, 186, 10]]], np.uint8)).save(tmp_path / "a.png")
    decoded = read_image(tmp_path / "a.png", "gamma_2.2", 0.0)
    np.testing.assert_allclose(decoded, [[[1, 0.4995, (10 / 255) ** 2.2]]], atol=5e-5)


def test_png_of_16_bit_is_counts(tmp_path: Path) -> None:
    """The black level is in counts: (c - 512) / 65535, before any decoding."""
    counts = np.array([[[600, 512, 65535], [500, 40000, 0]]], np.uint16)
    assert cv2.imwrite(str(tmp_path / "a.png"), counts[..., ::-1])
    expected = (counts.astype(np.float64) - 512) / 65535
    np.testing.assert_allclose(read_image(tmp_path / "a.png", "linear", 512.0), expected, atol=1e-7)
    below_black = read_image(tmp_path / "a.png", "srgb", 512.0)[0, 1, 0]
    assert below_black == pytest.approx((500 - 512) / 65535 / 12.92, rel=1e-5)


def test_written_exr_opens_elsewhere_and_here(tmp_path: Path) -> None:
    image = RGB.astype(np.float32)
    write_exr(tmp_path / "a.exr", image)
    channels = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    assert sorted(channels) == ["B", "G", "R"]
    assert channels["G"].pixels.dtype == np.float16
    np.testing.assert_array_equal(channels["G"].pixels, image[..., 1].astype(np.float16))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), image.astype(np.float16))


def test_written_channel(tmp_path: Path) -> None:
    image = RGB[..., 0].astype(np.float32)
    write_exr(tmp_path / "a.exr", image, half=False)
    np.testing.assert_array_equal(read_exr_channel(tmp_path / "a.exr"), image)
    with pytest.raises(InputError, match=r"a\.exr: expected a channel Z, found Y"):
        read_exr_channel(tmp_path / "a.exr", "Z")


def test_bright_pixels_stay_finite_in_half(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", np.full((2, 2), 1e6, np.float32))
    assert (read_exr_channel(tmp_path / "a.exr") == HALF_MAX).all()


def test_the_same_image_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.exr", "b.exr"):
        write_exr(tmp_path / name, RGB)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_written_png_is_srgb_for_floats_and_untouched_for_integers(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.array([[[1.5, 0.5029, -1.0]]], np.float32))
    assert np.asarray(Image.open(tmp_path / "a.png")).tolist() == [[[255, 188, 0]]]
    bytes_rgb = np.random.default_rng(1).integers(0, 255, (3, 4, 3), dtype=np.uint8)
    write_png(tmp_path / "b.png", bytes_rgb)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "b.png")), bytes_rgb)
    np.testing.assert_array_equal(read_stored(tmp_path / "b.png"), bytes_rgb)
    write_png(tmp_path / "c.png", bytes_rgb[..., 0])
    np.testing.assert_array_equal(read_mask(tmp_path / "c.png"), bytes_rgb[..., 0])


def test_png_of_one_bit_is_a_mask(tmp_path: Path) -> None:
    Image.fromarray(np.eye(4, 9, dtype=bool)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png"), np.eye(4, 9, dtype=np.uint8) * 255)


@pytest.mark.parametrize("share", [0, 0.1, 0.5, 0.97])
@pytest.mark.parametrize("suffix", [".exr", ".png", ".jpg"])
def test_cut_files_are_named(suffix: str, share: float, tmp_path: Path) -> None:
    path = tmp_path / f"cut{suffix}"
    image = np.random.default_rng(0).uniform(0, 1, (40, 50, 3))
    if suffix == ".exr":
        save_exr(path, image)
    else:
        assert cv2.imwrite(str(path), (image * 255).astype(np.uint8))
    read_stored(path)
    truncate(path, share)
    with pytest.raises(InputError, match=rf"cut\{suffix}: expected a whole"):
        read_stored(path)


@pytest.mark.parametrize("read", [read_image, read_mask, read_stored, read_exr_channel])
def test_a_missing_file_is_named(read, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.exr: expected a readable file"):
        read(tmp_path / "none.exr")


def test_transparency_is_no_colour_image(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((3, 3, 4), np.uint8)).save(tmp_path / "a.png")
    with pytest.raises(InputError, match="three channels R, G, B, found 4 channels"):
        read_image(tmp_path / "a.png")


def test_png_whose_header_asks_for_too_many_pixels_is_named(tmp_path: Path) -> None:
    """Sixty thousand pixels a side: OpenCV throws where it otherwise answers nothing."""
    body = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    header = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    (tmp_path / "large.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header)
    with pytest.raises(InputError, match=r"large\.png: expected"):
        read_image(tmp_path / "large.png")
