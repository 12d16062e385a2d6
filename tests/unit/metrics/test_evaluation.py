"""The evaluation protocol: who is scored, how groups are averaged, and what must not change a score."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
import torch

from pipeline.metrics.comparison import side_by_side
from pipeline.metrics.evaluation import PSNR_CEILING_DB, SPLITS, capped, evaluate, summarize, worst_median_best
from pipeline.metrics.lpips import BACKBONES, Lpips, build_features, linear_weights


@dataclass(frozen=True)
class Image:
    image: np.ndarray
    mask: np.ndarray
    camera: str = "cam00"
    frame: int = 0
    test_camera: bool = True
    test_frame: bool = False
    test_segment: bool = False
    test_pattern: bool = False
    validation: bool = False
    fully_lit: bool = True


def subject_image(seed: int = 0, height: int = 50, width: int = 44, **flags) -> Image:
    rng = np.random.default_rng(seed)
    mask = np.zeros((height, width), np.float32)
    mask[5:-5, 6:-6] = 1
    return Image(rng.uniform(0.1, 0.6, (height, width, 3)).astype(np.float32), mask, **flags)


def add_to(amount: float):
    def render(frame, image):
        return torch.tensor((image.image + amount) * image.mask[..., None]), torch.tensor(image.mask)

    return render


def test_only_held_out_images_are_scored_and_groups_are_complete():
    images = [
        subject_image(0, frame=0, test_camera=False),
        subject_image(1, frame=1, fully_lit=True, test_pattern=True),
        subject_image(2, frame=2, fully_lit=False, test_pattern=True),
        subject_image(3, frame=3, test_camera=True, test_segment=True, fully_lit=False),
    ]
    table = evaluate(add_to(0.05), images, dict.fromkeys(range(4)))
    assert table["index"].tolist() == [1, 2, 3]
    assert table.camera.tolist() == ["cam00"] * 3
    rows = summarize(table).set_index(["split", "lit"])
    assert rows.images.to_dict() == {
        ("test", "all"): 3, ("test", "full"): 1, ("test", "partial"): 2,
        ("test_cameras", "all"): 3, ("test_cameras", "full"): 1, ("test_cameras", "partial"): 2,
        ("test_frames", "all"): 0, ("test_frames", "full"): 0, ("test_frames", "partial"): 0,
        ("test_segments", "all"): 1, ("test_segments", "full"): 0, ("test_segments", "partial"): 1,
        ("test_patterns", "all"): 2, ("test_patterns", "full"): 1, ("test_patterns", "partial"): 1,
        ("novel_view_and_pose", "all"): 1, ("novel_view_and_pose", "full"): 0, ("novel_view_and_pose", "partial"): 1,
        **dict.fromkeys(product(("validation", "held_out_segments", "held_out_lights"), ("all", "full", "partial")), 0),
        ("novel_view_and_light", "all"): 2, ("novel_view_and_light", "full"): 1, ("novel_view_and_light", "partial"): 1,
    }  # fmt: skip
    assert rows.loc[("test_frames", "all"), ["psnr_db", "ssim", "lpips", "flip"]].isna().all()
    assert rows.loc[("test", "partial"), "psnr_db"] == pytest.approx(table.psnr_db[1:].mean())
    assert table.lpips.isna().all()


def test_validation_images_are_scored_apart_from_test_images():
    images = [
        subject_image(0, frame=0, test_camera=False, validation=True),
        subject_image(1, frame=1),
        subject_image(2, frame=2, test_camera=False),
    ]
    table = evaluate(add_to(0.05), images, dict.fromkeys(range(3)))
    assert table["index"].tolist() == [0, 1]
    rows = summarize(table)[lambda t: t.lit == "all"].set_index("split").images
    assert rows["validation"] == 1 and rows["test"] == 1 and rows["test_cameras"] == 1
    assert {row["index"] for row in worst_median_best(table).values()} == {1}


def test_new_light_and_new_expressions_are_told_apart():
    known = {"test_camera": False, "fully_lit": False}
    images = [
        subject_image(0, frame=0, **known | {"test_frame": True}),
        subject_image(1, frame=1, **known | {"test_pattern": True}),
        subject_image(2, frame=2, **known | {"test_frame": True, "fully_lit": True}),  # light that training knows
        subject_image(3, frame=3, **known | {"test_segment": True, "test_pattern": True}),
        subject_image(4, frame=4, **known | {"test_segment": True, "fully_lit": True}),
        subject_image(5, frame=5, test_camera=True, test_segment=True),
    ]
    table = evaluate(add_to(0.05), images, dict.fromkeys(range(6)))
    lights, segments = (table[SPLITS[name](table)].frame.tolist() for name in ("held_out_lights", "held_out_segments"))
    assert lights == [0, 1] and segments == [3, 4]
    assert table[SPLITS["novel_view_and_pose"](table)].frame.tolist() == [5]  # of a test camera, and a new pose


def test_exact_images_count_the_ceiling_in_both_ratios():
    row = {"frame": 0, "psnr_db": np.inf, "psnr_image": np.inf}
    assert capped(pd.DataFrame([row]))[["psnr_db", "psnr_image"]].eq(PSNR_CEILING_DB).all(axis=None)


def test_psnr_is_in_srgb_over_the_subject():
    flat = Image(np.full((40, 40, 3), 0.2, np.float32), np.ones((40, 40), np.float32))

    def srgb(v):
        return 1.055 * v ** (1 / 2.4) - 0.055

    table = evaluate(add_to(0.1), [flat], {0: None})
    assert table.psnr_db[0] == pytest.approx(-20 * math.log10(srgb(0.3) - srgb(0.2)), abs=1e-4)


def test_more_background_changes_no_score():
    image = subject_image()
    torch.manual_seed(0)
    lpips = Lpips(BACKBONES["alex"].taps, build_features("alex"), linear_weights("alex"))
    padded = Image(np.pad(image.image, ((30, 20), (17, 40), (0, 0))), np.pad(image.mask, ((30, 20), (17, 40))))
    tight, wide = (evaluate(add_to(0.05), [i], {0: None}, lpips).iloc[0] for i in (image, padded))
    for metric in ("psnr_db", "ssim", "lpips", "flip", "foreground_pixels"):
        assert wide[metric] == pytest.approx(tight[metric], rel=1e-6), metric
    assert np.isfinite(tight.lpips)


def test_pixels_of_the_captured_background_do_not_count():
    image = subject_image()
    littered = replace(image, image=np.where(image.mask[..., None] > 0, image.image, np.float32(0.9)))
    a, b = (evaluate(add_to(0.05), [i], {0: None}).iloc[0] for i in (image, littered))
    assert a.psnr_db == b.psnr_db
    assert a.ssim == b.ssim
    assert a.flip == b.flip


def covered_cross(half_width_px: float) -> Image:
    """A striped cross as a camera sees it, each pixel as bright as its covered share, and a mask of zeros and ones."""
    fine = 16
    y, x = np.mgrid[: 40 * fine, : 40 * fine] / fine
    across, along = np.sort([np.abs(x - 20.3), np.abs(y - 19.8)], 0)
    covered = (across < half_width_px) & (along < 16)
    color = covered[..., None] * (0.3 + 0.2 * np.sin(x[..., None] + np.arange(3)))
    share, seen = (a.reshape(40, fine, 40, fine, -1).mean((1, 3)) for a in (covered[..., None] * 1.0, color))
    return Image(seen.astype(np.float32), (share[..., 0] >= 0.5).astype(np.float32))


def test_what_was_photographed_scores_full_marks_although_the_mask_cuts_its_edge():
    cross = covered_cross(4.0)
    cut = float(np.abs(cross.image * (1 - cross.mask[..., None])).max())
    assert cut > 0.1  # the mask does take light from the cross
    row = evaluate(lambda frame, image: (image.image, image.mask), [cross], {0: None}).iloc[0]
    assert row.psnr_db == math.inf
    assert row.ssim == pytest.approx(1, abs=1e-6)
    assert row.flip == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("larger_px", "scored"), [(0.4, False), (2.5, True)])
def test_light_beside_the_subject_is_scored_from_the_second_pixel_on(larger_px, scored):
    cross, larger = covered_cross(4.0), covered_cross(4.0 + larger_px)
    spilt = np.where(cross.mask[..., None] > 0, cross.image, larger.image)
    row = evaluate(lambda frame, image: (spilt, image.mask), [cross], {0: None}).iloc[0]
    assert row.psnr_db == math.inf  # nothing of it lies on the subject
    assert (row.ssim < 0.99) == scored
    assert (row.flip > 0.005) == scored


def test_an_exact_image_does_not_make_a_mean_infinite():
    images = [subject_image(0, frame=0), subject_image(1, frame=1)]

    def render(frame, image):
        return add_to(0.0 if image.frame == 0 else 0.05)(frame, image)

    table = evaluate(render, images, {0: None, 1: None})
    assert table.psnr_db[0] == math.inf
    assert table.ssim[0] == pytest.approx(1)
    assert summarize(table).psnr_db[0] == pytest.approx((PSNR_CEILING_DB + table.psnr_db[1]) / 2)


def test_an_image_without_subject_is_kept_but_not_averaged():
    empty = replace(subject_image(0), mask=np.zeros((50, 44), np.float32))
    images = [empty, subject_image(1, frame=1)]
    table = evaluate(add_to(0.05), images, {0: None, 1: None})
    assert math.isnan(table.psnr_db[0])
    assert table.foreground_pixels[0] == 0
    assert summarize(table).psnr_db[0] == table.psnr_db[1]


def test_a_broken_rendering_is_an_error_that_names_the_image():
    def not_a_number(frame, image):
        return np.full(image.image.shape, np.nan), image.mask

    def too_small(frame, image):
        return image.image[1:], image.mask[1:]

    for render, words in ((not_a_number, "finite"), (too_small, "shape")):
        with pytest.raises(ValueError, match=f"camera cam00, frame 0.*{words}"):
            evaluate(render, [subject_image()], {0: None})


def test_no_test_images_give_empty_rows():
    rows = summarize(evaluate(add_to(0.1), [subject_image(test_camera=False)], {0: None}))
    assert len(rows) == 30
    assert (rows.images == 0).all()
    assert rows.psnr_db.isna().all()


def test_side_by_side_shows_the_pixels_that_were_scored():
    captured = np.random.default_rng(0).uniform(size=(20, 30, 3)).astype(np.float32)
    rendered = captured.copy()
    rendered[4, 5] = 1 - captured[4, 5].round()
    picture = side_by_side(captured, rendered, "cam00 frame 3")
    rows = picture[-60:]
    np.testing.assert_array_equal(rows[1::3, 1:90:3], np.round(captured * 255).astype(np.uint8))
    error = rows[1::3, 1 + 2 * 96 : 1 + 2 * 96 + 90 : 3].astype(int).sum(2)
    assert np.unravel_index(error.argmax(), error.shape) == (4, 5)
    assert (np.delete(error.ravel(), 4 * 30 + 5) < 10).all()


def test_the_color_bar_runs_from_its_brightest_to_its_darkest():
    image = np.zeros((30, 20, 3), np.float32)
    bar = side_by_side(image, image, "")[-90:, 3 * 60 + 2 * 6 + 6 + 2].astype(int).sum(1)
    assert bar[0] > bar[45] > bar[-1]
    assert bar[-1] < 10


def test_round_subject_before_a_bright_wall_scores_full_marks_if_it_is_exact():
    """In the corners of its box there is wall: what was captured there is taken for black, as it is rendered."""
    rows, columns = np.mgrid[0:60, 0:60] - 29.5
    mask = (rows**2 + columns**2 < 24**2).astype(np.float32)
    image = replace(subject_image(3, 60, 60), mask=mask)
    image.image[mask == 0] = 0.9
    (row,) = evaluate(add_to(0.0), [image], {0: None}).itertuples()
    assert row.psnr_db == math.inf
    assert row.ssim == pytest.approx(1, abs=1e-9) and row.flip == pytest.approx(0, abs=1e-6)


def test_worst_and_best_are_those_of_least_and_most_decibels():
    images = [subject_image(frame, frame=frame) for frame in range(3)]
    table = evaluate(add_to(0.05), images, dict.fromkeys(range(3))).assign(psnr_db=[20.0, 40.0, 30.0])
    shown = worst_median_best(table)
    assert {name: row.frame for name, row in shown.items()} == {"worst": 0, "median": 2, "best": 1}
