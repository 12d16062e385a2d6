"""Scores of renderings against held-out images, one by one and averaged.

Their protocol is written beside them.

The protocol: the captured image times its mask and the rendering over black, both converted to sRGB and clipped.
PSNR over the pixels whose mask is at least one half; SSIM, LPIPS, FLIP and, where it is asked for, MS-SSIM on the box
around these pixels, grown to the smallest side that the metric has (`pipeline.metrics.image_metrics`). Images smaller
than that have no such score. Each image gets its scores; a group's score is the plain mean over its images. Neither a
larger crop nor more background changes any of them.

The ring of pixels beside the subject is black in both. A mask of zeros and ones cuts through pixels that the subject
covers in part; those of them that it calls background hold up to half a pixel of subject, which it takes from the
captured image. Left in, the ring would score the photographed scene itself below an image that ends half a pixel too
early. Light further out is compared with black.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from pipeline.base.array_module import is_tensor
from pipeline.base.color import srgb_from_linear
from pipeline.base.progress import progress
from pipeline.base.splits import TEST_FLAGS, VALIDATION
from pipeline.metrics.image_metrics import DEFAULT_METRICS, ImageMetric, ImagePair, boxes_in_words, metrics_in

FRAMES_AHEAD = 2
"""Frames traced ahead of the one that is rendered: tracing one takes about as long as rendering and scoring twice the
pictures of it."""

SCORED_LATER = 4
"""Pictures that wait for their scores while the next is rendered; each is kept as long."""

FOREGROUND_MASK = 0.5
"""A pixel counts as subject if at least half of it is."""

TOUCHING = np.ones((3, 3), bool)
"""A pixel and its eight neighbours."""

PSNR_CEILING_DB = 100.0
"""What an exact match counts in a mean. Stored images are float16: near white their rounding alone is worth 77 dB, so
no image that is not an exact match comes near; without a ceiling one exact (say, black) image makes a mean infinite."""

HELD_OUT = (*TEST_FLAGS, VALIDATION)
"""Flags of images that do not train."""

COLOR_SPACE = "sRGB"
SPLITS: dict[str, Callable[[pd.DataFrame], pd.Series]] = {
    "test": lambda t: t[list(TEST_FLAGS)].any(axis=1),
    VALIDATION: lambda t: t.validation,
    "test_cameras": lambda t: t.test_camera,
    "test_frames": lambda t: t.test_frame,
    "test_segments": lambda t: t.test_segment,
    "test_patterns": lambda t: t.test_pattern,
    # What RGCA's tables 1 and 2 tell apart: new expressions, and new light on expressions between those of training.
    "held_out_segments": lambda t: t.test_segment & ~t.test_camera,
    "held_out_lights": lambda t: (t.test_frame | t.test_pattern) & ~(t.test_segment | t.test_camera | t.fully_lit),
    # What RFGCA's table 1 scores: poses that training did not see, from cameras that it did not have.
    "novel_view_and_pose": lambda t: t.test_camera & (t.test_frame | t.test_segment),
    # What sets of one light at a time score: lights that training did not see, from cameras that it did not have.
    "novel_view_and_light": lambda t: t.test_camera & t.test_pattern,
}
TABLES = ("held_out_segments", "held_out_lights", "novel_view_and_pose")
"""Splits that have columns of their own in ablations.csv, and tables in the report: those of RGCA and of RFGCA."""

LIT: dict[str, Callable[[pd.DataFrame], pd.Series]] = {
    "all": lambda t: pd.Series(True, t.index),
    "full": lambda t: t.fully_lit,
    "partial": lambda t: ~t.fully_lit,
}


@runtime_checkable
class ScoredImage(Protocol):
    """Fields of an image record that scoring reads.

    `pipeline.capture.records.ImageRecord` has them.
    """

    camera: str
    frame: int
    test_camera: bool
    test_frame: bool
    test_segment: bool
    test_pattern: bool
    validation: bool
    fully_lit: bool
    image: Any
    mask: Any


def region(metrics: Sequence[ImageMetric]) -> str:
    """The part of an image that each metric looks at, for the column of that name."""
    return (
        f"psnr: pixels with mask >= {FOREGROUND_MASK}, per image, then mean over images "
        f"(exact matches count {PSNR_CEILING_DB:g} dB); {boxes_in_words(metrics)}; "
        "captured x mask and rendering, both over black, the ring of pixels beside the subject black in both"
    )


Render = Callable[[Any, Any], tuple[Any, Any]]
"""(frame record, image record) -> linear RGB [h, w, 3] over black and alpha [h, w]; tensors or arrays."""


def evaluate(
    render: Render, images: Sequence[ScoredImage], frames: Mapping[int, Any],
    lpips: Callable[[Any, Any], Any] | None = None, metrics: Sequence[ImageMetric] = DEFAULT_METRICS,
    trace: Callable[[Any], Any] = lambda frame: frame, image_pixels: Mapping[str, int] = MappingProxyType({}),
    shown_face: Callable[[Any, Any], np.ndarray] | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Render and score every image that a split holds out: one row each, in their order.

    LPIPS is NaN if `lpips` is None. Images without foreground get NaN for PSNR.

    Args:
        render: makes the picture that is scored.
        images, frames: of shards.
        lpips, metrics: scores that are taken.
        trace: frame record -> what `render` takes of a frame. It runs on threads of its own for the frames that
            come next, while the one before is rendered.
        image_pixels: of the whole images of each camera, of which shards hold parts, where they are known.
        shown_face: (frame record, image record) -> the pixels that show a face, where that is known.

    Raises:
        ValueError: if a rendering has another shape than its image, or is not finite.
    """
    rows, scores = [], []
    held_out = [(i, image.frame) for i, image in enumerate(images) if any(getattr(image, name) for name in HELD_OUT)]
    made = with_frames(held_out, lambda number: trace(frames[number]))
    with ThreadPoolExecutor(1) as scoring:
        for index, frame in progress(made, "evaluate", total=len(held_out)):
            image = images[index]
            captured, rendered = scored_pair(render, image, frame)
            foreground = np.asarray(image.mask) >= FOREGROUND_MASK
            flags = {name: getattr(image, name) for name in (*HELD_OUT, "fully_lit")}
            counts = {"foreground_pixels": int(foreground.sum())}
            rows.append({"index": index, "camera": image.camera, "frame": image.frame, **flags, **counts})
            face = None if shown_face is None else shown_face(frames[image.frame], image)
            pair = ImagePair(rendered, captured, foreground, lpips, image_pixels.get(image.camera, 0), face)
            scores.append(scoring.submit(measure, metrics, pair))
            if len(scores) > SCORED_LATER:
                scores[-SCORED_LATER].result()
    rows = [row | score.result() for row, score in zip(rows, scores, strict=True)]
    columns = ["index", "camera", "frame", *HELD_OUT, "fully_lit"]
    flags = dict.fromkeys(columns[3:], bool)
    names = [metric.name for metric in metrics]
    return pd.DataFrame(rows, columns=[*columns, *names, "foreground_pixels"]).astype(flags)


def measure(metrics: Sequence[ImageMetric], pair: ImagePair) -> dict[str, float]:
    """Scores of a pair of images by the names of their metrics."""
    return {metric.name: metric.measure(pair) for metric in metrics}


def with_frames(numbered: Sequence[tuple[int, int]], make: Callable[[int], Any]) -> Iterator[tuple[int, Any]]:
    """Indices of images, each with its frame, made from its number.

    Images of one frame that follow each other share it: renderers keep what depends on it only. The next frames are
    made on threads of their own, as many as `FRAMES_AHEAD`.
    """
    runs = [(number, [index for index, _ in run]) for number, run in groupby(numbered, lambda pair: pair[1])]
    with ThreadPoolExecutor(FRAMES_AHEAD) as pool:
        coming = deque(pool.submit(make, number) for number, _ in runs[:FRAMES_AHEAD])
        for place, (_, run) in enumerate(runs):
            frame = coming.popleft().result()
            coming.extend(pool.submit(make, number) for number, _ in runs[place + FRAMES_AHEAD :][:1])
            yield from ((index, frame) for index in run)


def scored_pair(render: Render, image: ScoredImage, frame: Any) -> tuple[np.ndarray, np.ndarray]:
    """Render an image; return what was captured and what was rendered, as they are scored.

    Both are sRGB in [0, 1], float32 [h, w, 3], over black and black beside the subject.
    """
    rgb, _ = render(frame, image)
    rgb = np.asarray(rgb.detach().cpu() if is_tensor(rgb) else rgb, dtype=np.float32)
    name = f"rendering of camera {image.camera}, frame {image.frame}"
    if rgb.shape != image.image.shape:
        raise ValueError(f"{name}: expected shape {image.image.shape}, found {rgb.shape}")
    if not np.isfinite(rgb).all():
        raise ValueError(f"{name}: expected finite pixels, found {(~np.isfinite(rgb)).sum()} that are not")
    foreground = np.asarray(image.mask) >= FOREGROUND_MASK
    return scored_srgb(image.image * image.mask[..., None], foreground), scored_srgb(rgb, foreground)


def scored_srgb(
    rgb_linear: Float[np.ndarray, "h w 3"], foreground: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """sRGB that the protocol scores: clipped, and black in the ring beside the subject.

    Linear light is clipped to [0, 1] first, which is the same as clipping after. For pictures that are only looked at
    see `pipeline.metrics.comparison.preview_srgb`.
    """
    kept = (foreground | ~binary_dilation(foreground, TOUCHING))[..., None]
    return srgb_from_linear(np.clip(rgb_linear * kept, 0, 1)).clip(0, 1)


SHOWN = ("worst", "median", "best")
"""Test images of each avatar that are shown, by PSNR; ends of the names of their pictures."""


def worst_median_best(per_image: pd.DataFrame) -> dict[str, pd.Series]:
    """The rows of test images to look at, by PSNR; none if no image has one."""
    ranked = per_image[SPLITS["test"](per_image) & per_image.psnr_db.notna()].sort_values("psnr_db", kind="stable")
    places = zip(SHOWN, (0, len(ranked) // 2, len(ranked) - 1), strict=True)
    return {name: ranked.iloc[place] for name, place in places} if len(ranked) else {}


def capped(per_image: pd.DataFrame) -> pd.DataFrame:
    """The scores with every PSNR no larger than what exact matches count."""
    ratios = [name for name in ("psnr_db", "psnr_image", "psnr_face") if name in per_image]
    return per_image.assign(**{name: per_image[name].clip(upper=PSNR_CEILING_DB) for name in ratios})


def summarize(per_image: pd.DataFrame) -> pd.DataFrame:
    """Average scores: one row per split and lighting.

    Columns split, lit, images, foreground_pixels and the mean of each metric.

    An empty group keeps its row, with 0 images and NaN scores: an absent number must not look like a forgotten one.
    """
    bounded = capped(per_image)
    rows = []
    for split, in_split in SPLITS.items():
        for lit, in_lit in LIT.items():
            group = bounded[in_split(bounded) & in_lit(bounded)]
            means = {metric.name: group[metric.name].astype(float).mean() for metric in metrics_in(per_image)}
            counts = {"images": len(group), "foreground_pixels": int(group.foreground_pixels.sum())}
            rows.append({"split": split, "lit": lit, **counts, **means})
    return pd.DataFrame(rows)
