"""The end of a sensor's linear range, from planted sensors and from photographs of a chart."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.photographed_targets import FILTERS_NM, read_series, series_linearity
from pipeline.base.errors import InputError
from pipeline.calibration.color import sensor_linearity
from pipeline.calibration.color.chart_images import ChartFormat, read_linearity
from pipeline.calibration.color.sensor_linearity import measure_linearity
from tests.support.shared_data import shared_data

CHARTS, needs_charts = shared_data("data/chart_photographs")

SECONDS = np.array([0.025, 0.05, 0.1, 0.25])


def expose(bend_from: float, seconds=SECONDS, black=16.0, full=1023.0, pixels=20_000):
    """Counts of a sensor that collects a tenth less of the light above a count, and clips at full scale."""
    random = np.random.default_rng(0)
    signal = random.uniform(200, 12_000, pixels) * seconds[:, None]
    signal = np.minimum(signal, 0.9 * signal + 0.1 * bend_from)
    return np.clip(np.round(black + signal + random.normal(0, 1.0, signal.shape)), 0, full)


def test_a_bend_is_found_where_its_departure_reaches_the_tolerance():
    """Above a signal of 400, 0.9 of the light counts: 2 % are missing at predicted 500, stored at 16 + 490."""
    found = measure_linearity(expose(400), SECONDS, 16.0, 1023.0, 0.02)
    assert found.up_to == pytest.approx(506, rel=0.03)  # half a bin, of 25 counts
    assert found.black_level == pytest.approx(16, abs=1)


def test_order_of_the_exposures_does_not_matter():
    turned = measure_linearity(expose(400)[::-1], SECONDS[::-1].copy(), 16.0, 1023.0, 0.02)
    assert turned.up_to == measure_linearity(expose(400), SECONDS, 16.0, 1023.0, 0.02).up_to


def test_a_linear_sensor_is_so_up_to_where_it_clips():
    """Of what would be 2 % above full scale, 2 % are missing."""
    found = measure_linearity(expose(np.inf), SECONDS, 16.0, 1023.0, 0.02)
    assert found.up_to == pytest.approx(1023, rel=0.03)


def test_a_series_that_never_gets_bright_names_the_largest_count():
    """Signals up to 600 of a sensor that bends at 700."""
    short = SECONDS / 5
    found = measure_linearity(expose(700, short), short, 16.0, 1023.0, 0.02)
    assert np.isnan(found.up_to)
    assert str(found).startswith(f"linear up to {found.brightest:.4g}, the largest count in the series")
    assert found.brightest == pytest.approx(616, abs=26)  # a bin


@pytest.mark.parametrize("seconds", [SECONDS[:1], np.array([0.1, 0.12])], ids=["one exposure", "nearly the same"])
def test_too_little_of_a_series_tells_nothing(seconds):
    assert measure_linearity(expose(400, seconds), seconds, 16.0, 1023.0, 0.02) is None


def test_a_black_level_that_is_not_declared_shows():
    found = measure_linearity(expose(np.inf), SECONDS, 0.0, 1023.0, 0.5)
    assert found.black_level == pytest.approx(16, abs=1)


def write_series(folder, counts, side, suffix):
    entries = []
    for number, (image, seconds) in enumerate(zip(counts, SECONDS, strict=True)):
        assert cv2.imwrite(str(folder / f"{number}{suffix}"), image.reshape(side, -1))
        entries.append({"path": f"{number}{suffix}", "exposure_s": seconds})
    return entries


@pytest.mark.parametrize(("kind", "suffix"), [("uint16", ".png"), ("float32", ".tif")])
def test_series_that_is_read_image_by_image_tells_what_it_tells_as_a_whole(kind, suffix, tmp_path, monkeypatch):
    """Of floats, full scale is the largest of all pixels, also of those that are not looked at."""
    monkeypatch.setattr(sensor_linearity, "MOST_SAMPLES", 6000)
    counts = (64 * expose(400)).astype(kind)
    counts[1, 1] = 65535
    expected = measure_linearity(counts.astype(np.float64), SECONDS, 1024.0, 65535.0, 0.02)
    found = read_linearity(tmp_path, write_series(tmp_path, counts, 100, suffix), ChartFormat("linear", 1024.0), 0.02)
    assert str(found) == str(expected) and found.full == expected.full
    np.testing.assert_array_equal(found.predicted, expected.predicted)
    np.testing.assert_array_equal(found.departure, expected.departure)


def test_images_of_two_sizes_are_no_series(tmp_path):
    entries = write_series(tmp_path, expose(400).astype(np.uint16), 100, ".png")
    assert cv2.imwrite(str(tmp_path / "2.png"), np.zeros((4, 5), np.uint8))
    with pytest.raises(InputError, match=r"0\.png: .* found \(100, 200\) uint16 and \(4, 5\) uint8"):
        read_linearity(tmp_path, entries, ChartFormat("linear", 16.0), 0.02)


@needs_charts
def test_three_series_of_one_sensor_agree_and_saturation_is_no_limit():
    """Raw mosaics behind three filters: falls short by 2 % well before 255, and not before 170."""
    limits = []
    for band in FILTERS_NM:
        found = series_linearity(read_series(CHARTS, band), 0.02)
        limits.append(found.up_to)
        # An 8-bit count is good to half a step; the mosaics clip noise below 0.
        assert abs(found.black_level) <= 1.0
        # Up to 120 counts the sensor is linear to 1.5 %; by what is collected for 300, a tenth and more is lost.
        assert np.abs(found.departure[found.predicted < 120]).max() < 0.015
        assert found.departure[np.searchsorted(found.predicted, 300)] < -0.1
    assert min(limits) > 170 and max(limits) < 240
