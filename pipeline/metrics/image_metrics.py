"""Image metrics, one row each: to add one, add a row to `IMAGE_METRICS`.

A metric that is off by default is also named in the setting `evaluate_avatar.metrics`, which a test holds against the
rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from pipeline.metrics.images import (
    LPIPS_SMALLEST_SIDE,
    MS_SSIM_SMALLEST_SIDE,
    SSIM_WINDOW,
    flip,
    foreground_box,
    masked_psnr_db,
    ms_ssim,
    psnr_db,
    ssim,
)


@dataclass(frozen=True)
class ImagePair:
    """A rendering and what was captured, to be compared.

    Attributes:
        rendered, captured: sRGB in [0, 1] over black.
        foreground: the pixels of the subject.
        lpips: `pipeline.metrics.lpips.Lpips`, if its weights are there.
        image_pixels: of the whole image that this is a part of; 0: not known.
        face: the pixels that show a face; None: not known.
    """

    rendered: Float[np.ndarray, "h w 3"]
    captured: Float[np.ndarray, "h w 3"]
    foreground: Bool[np.ndarray, "h w"]
    lpips: Callable[[Any, Any], Any] | None = None
    image_pixels: int = 0
    face: Bool[np.ndarray, "h w"] | None = None

    def around_subject(self, smallest_side: int) -> ImagePair:
        """The box around the foreground, grown to that many pixels a side where the image allows."""
        box = foreground_box(self.foreground, smallest_side)
        face = None if self.face is None else self.face[box]
        return replace(
            self, rendered=self.rendered[box], captured=self.captured[box], foreground=self.foreground[box], face=face
        )


@dataclass(frozen=True)
class ImageMetric:
    """One row: how a pair of images is scored, and how the score is read.

    Attributes:
        name: the column of all tables.
        title: for people, without the unit.
        digits: decimals that are shown.
        higher_is_better: else lower is.
        smallest_side: pixels a side of the box around the subject, at least; images with less have no score.
        score: of the pair in that box.
        unit: of the score, if it has one.
        note: what the protocol says of it beside the box.
        by_default: scored without being asked for.
    """

    name: str
    title: str
    digits: int
    higher_is_better: bool
    smallest_side: int
    score: Callable[[ImagePair], float]
    unit: str = ""
    note: str = ""
    by_default: bool = True

    @property
    def heading(self) -> str:
        """The title with its unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def measure(self, pair: ImagePair) -> float:
        """The score; NaN without foreground, or if the image is too small."""
        inside = pair.around_subject(self.smallest_side)
        if not pair.foreground.any() or min(inside.foreground.shape) < self.smallest_side:
            return float("nan")
        return self.score(inside)


def _lpips(pair: ImagePair) -> float:
    return float("nan") if pair.lpips is None else _between(pair, pair.lpips)


def _st_lpips(pair: ImagePair) -> float:
    from pipeline.metrics.shift_tolerant_lpips import open_st_lpips

    return _between(pair, open_st_lpips())


def _between(pair: ImagePair, distance: Callable[[Any, Any], Any]) -> float:
    """Distance of two images as networks take them."""
    import torch

    images = (pair.rendered, pair.captured)
    x, y = (torch.from_numpy(image.transpose(2, 0, 1).copy())[None].float() for image in images)
    return float(distance(x, y))


def _psnr_face(pair: ImagePair) -> float:
    seen = None if pair.face is None else pair.face & pair.foreground
    return psnr_db(pair.rendered, pair.captured, seen) if seen is not None and seen.any() else float("nan")


IMAGE_METRICS = (
    ImageMetric("psnr_db", "PSNR", digits=2, higher_is_better=True, smallest_side=1, unit="dB",
                score=lambda pair: psnr_db(pair.rendered, pair.captured, pair.foreground)),
    ImageMetric("ssim", "SSIM", digits=3, higher_is_better=True, smallest_side=SSIM_WINDOW,
                score=lambda pair: ssim(pair.rendered, pair.captured)),
    ImageMetric("lpips", "LPIPS", digits=3, higher_is_better=False, smallest_side=LPIPS_SMALLEST_SIDE, score=_lpips),
    ImageMetric("flip", "FLIP", digits=3, higher_is_better=False, smallest_side=SSIM_WINDOW,
                score=lambda pair: flip(pair.rendered, pair.captured)),
    ImageMetric("ms_ssim", "MS-SSIM", digits=3, higher_is_better=True, smallest_side=MS_SSIM_SMALLEST_SIDE,
                score=lambda pair: ms_ssim(pair.rendered, pair.captured), by_default=False,
                note="five scales, empty for smaller images"),
    ImageMetric("st_lpips", "ST-LPIPS", digits=3, higher_is_better=False, smallest_side=LPIPS_SMALLEST_SIDE,
                score=_st_lpips, by_default=False),
    ImageMetric("psnr_image", "PSNR of the image", digits=2, higher_is_better=True, smallest_side=1, unit="dB",
                score=lambda pair: masked_psnr_db(pair.rendered, pair.captured, pair.foreground, pair.image_pixels),
                note="all pixels of the image, those beside the subject without error", by_default=False),
    ImageMetric("psnr_face", "PSNR of the face", digits=2, higher_is_better=True, smallest_side=1, unit="dB",
                score=_psnr_face, note="pixels of the subject that show its face, empty where none does",
                by_default=False),
)  # fmt: skip
"""All metrics, in the order of their columns; the first one ranks images."""

DEFAULT_METRICS = tuple(metric for metric in IMAGE_METRICS if metric.by_default)


def asked_metrics(names: Iterable[str]) -> tuple[ImageMetric, ...]:
    """The metrics that are always scored, and those named."""
    wanted = set(names)
    return tuple(metric for metric in IMAGE_METRICS if metric.by_default or metric.name in wanted)


def metrics_in(columns: Iterable[str]) -> tuple[ImageMetric, ...]:
    """The metrics that a table with such columns holds."""
    present = set(columns)
    return tuple(metric for metric in IMAGE_METRICS if metric.name in present)


def boxes_in_words(metrics: Sequence[ImageMetric]) -> str:
    """Least box sides of all metrics but the first, in words, for the protocol."""
    boxed = metrics[1:]
    sides = {side: [m.name for m in boxed if m.smallest_side == side] for side in [m.smallest_side for m in boxed]}
    least = ", ".join(f"{', '.join(names)} at least {side}" for side, names in sides.items())
    notes = "".join(f"; {metric.name}: {metric.note}" for metric in boxed if metric.note)
    return f"{', '.join(m.name for m in boxed)}: box around these pixels ({least} px a side{notes}), mean over images"
