"""Verdicts on each camera's colour calibration, and what to do where it is weak."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.base.errors import listed
from pipeline.calibration.color.chart_images import ChartFormat
from pipeline.calibration.color.color_chart import LEAST_PIXELS, Patches
from pipeline.calibration.color.color_response import Response
from pipeline.calibration.color.sensor_linearity import BLACK_SHARE, Linearity
from pipeline.config.calibrate_color import CalibrateColor

MOST_DIRTY = 6
"""One of so many patches dirt or a reflection may spoil, 4 of 24; more that do not fit have a common cause."""

MOST_HIDDEN = 3
"""One of so many patches something may hide, 8 of 24: with more, what hides them may fit as well as the chart does."""

GLARING_SHARE = 0.01
"""Share of saturated pixels in an image without a chart from which the exposure is worth a mention."""


@dataclass(frozen=True)
class Flaw:
    """Reason for a camera to be weak or failed: expected, found, and what to do."""

    grade: Literal["weak", "failed"]
    expected: str
    found: str
    hint: str

    def __str__(self) -> str:
        return f"expected {self.expected}, found {self.found}; {self.hint}"


def black_flaws(sensor: Linearity, form: ChartFormat) -> list[Flaw]:
    """Flaw of a black level that is not the one a series of exposures shows."""
    given = float(np.mean(form.black_level))
    if not abs(sensor.black_level - given) > BLACK_SHARE * sensor.full:
        return []
    hint = "correct black_level, of calibration.color or of images; was the series exposed as its table says?"
    return [Flaw("weak", f"a black level of {given:g}", f"{sensor.black_level:.3g} by the series of exposures", hint)]


def patch_flaws(patches: Patches | None, saturated_share: float, settings: CalibrateColor) -> list[Flaw]:
    """Flaws that keep a response from being fitted at all.

    Args:
        patches: None if no chart was found.
        saturated_share: of the pixels of the whole image.
    """
    if patches is None:
        found = f"none, and {saturated_share:.0%} of the image saturated" if saturated_share > GLARING_SHARE else "none"
        hint = "is it whole, sharp, not overexposed and larger than a tenth of the image? if so, say where its corners "
        hint += "are: calibration.color.corners"
        return [Flaw("failed", "a 24-patch chart", found, hint)]
    if (used := int(patches.used.sum())) < settings.least_patches:
        expected = f"at least {settings.least_patches} patches of {LEAST_PIXELS} pixels and more, not saturated"
        hint = "expose less, bring the chart nearer, or mend its corners if they are given"
        return [Flaw("failed", expected, f"{used} of {len(patches.used)}", hint)]
    return []


def response_flaws(response: Response, settings: CalibrateColor) -> list[Flaw]:
    """Flaws of a fitted response."""
    residual, sigma = response.relative_residual(), response.relative_sigma()
    median = float(np.nanmedian(residual))
    if median > settings.largest_residual:
        expected = f"patches that fit the chart's values to {settings.largest_residual:.1%} of the brightest"
        hint = (
            "is it the chart that patches describes, is part of it hidden, is transfer right, are the corners in order?"
        )
        return [Flaw("failed", expected, f"{median:.1%} (median)", hint)]
    hidden = 1 + np.flatnonzero(response.odd(settings.largest_residual))
    if len(hidden) > (most := len(residual) // MOST_HIDDEN):
        expected = f"a chart of which at most {most} patches show something else"
        hint = "is part of it hidden, out of the image or under another light?"
        return [Flaw("failed", expected, f"{len(hidden)}: {listed(hidden)}", hint)]
    if sigma > settings.largest_sigma:
        expected = f"a response known to {settings.largest_sigma:.1%}"
        hint = "the patches that are left are of too few hues: expose less, or record without noise"
        return [Flaw("failed", expected, f"{sigma:.1%}", hint)]
    flaws = []
    if sigma > settings.good_sigma:
        expected = f"a response known to {settings.good_sigma:.1%}"
        flaws.append(Flaw("weak", expected, f"{sigma:.1%}", "bring the chart nearer, light it better, expose longer"))
    if len(odd := 1 + np.flatnonzero(residual > settings.good_residual)):
        expected = f"patches that fit to {settings.good_residual:.1%} of the brightest"
        found = f"up to {np.nanmax(residual):.1%} at patches {listed(odd)}"
        hint = "are they dirty or in shadow? they hardly count in the fit"
        if len(odd) > len(residual) // MOST_DIRTY:
            hint = "is the light uneven across the chart, does it reflect a lamp, is transfer right?"
        flaws.append(Flaw("weak", expected, found, hint))
    if response.patches.mirrored():
        hint = "if the camera's other images are mirrored too, mirror them all"
        flaws.append(Flaw("weak", "an image as the camera saw it", "a mirrored chart", hint))
    return flaws


def light_flaws(responses: Mapping[str, Response], settings: CalibrateColor) -> dict[str, list[Flaw]]:
    """Cameras whose white differs too much from the median camera's.

    By more than cameras of one rig do among themselves.

    A response holds the light on the chart, which the correction undoes as if it were the camera's doing.
    """
    if not responses:
        return {}
    white = np.log([np.maximum(response.matrix.sum(1), np.finfo(float).tiny) for response in responses.values()])
    brightness, tint = white[:, 1], white[:, [0, 2]] - white[:, 1:2]
    rows = zip(responses, brightness - np.median(brightness), tint - np.median(tint, axis=0), strict=True)
    return {name: list(_light_flaws(float(brighter), tinted, settings)) for name, brighter, tinted in rows}


def _light_flaws(brighter: float, tinted: np.ndarray, settings: CalibrateColor) -> Iterator[Flaw]:
    largest = float(np.exp(np.abs(tinted).max()))
    if largest > settings.good_tint:
        failed = largest > settings.largest_tint
        allowed = settings.largest_tint if failed else settings.good_tint
        channel, sign = ("red", "blue")[int(np.abs(tinted).argmax())], tinted[np.abs(tinted).argmax()]
        found = f"{largest:.2f} times {'more' if sign > 0 else 'less'} {channel} against green"
        hint = "light the chart alike for all cameras; if cameras of this rig differ by design, raise "
        hint += f"calibrate_color.{'largest_tint' if failed else 'good_tint'}"
        expected = f"the median camera's white within a factor of {allowed:g}"
        yield Flaw("failed" if failed else "weak", expected, found, hint)
    if abs(brighter) > np.log(settings.good_brightness):
        expected = f"the median camera's brightness within a factor of {settings.good_brightness:g}"
        found = f"{np.exp(abs(brighter)):.2f} times {'brighter' if brighter > 0 else 'darker'}"
        yield Flaw("weak", expected, found, "fine if its exposure differs; if the light on the chart did, record anew")
