"""The table on drawn scores: means, pairing, subjects, and how often chance passes."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.metrics.ablation_table import ALL, compare
from pipeline.metrics.evaluation import PSNR_CEILING_DB


def scores_of(rng, subject: str, effects: dict[str, float], frames: int = 24) -> pd.DataFrame:
    """PSNR of two cameras' images: a hard one is hard for all; variants add effect and noise."""
    images = pd.DataFrame({"camera": ["a", "b"] * frames, "frame": np.repeat(np.arange(frames), 2)})
    images["fully_lit"] = images.frame % 3 == 0
    images = images.assign(test_camera=False, test_frame=True, test_segment=False, test_pattern=False)
    hard = 27 + 3 * rng.standard_normal(len(images))
    shared = {name: 0.2 * rng.standard_normal(frames)[images.frame] for name in effects}
    tables = [
        images.assign(
            subject=subject, variant=name, psnr_db=hard + effect + shared[name], ssim=0.9, lpips=np.nan, flip=0.1
        )
        for name, effect in effects.items()
    ]
    return pd.concat(tables, ignore_index=True)


def rows_of(table: pd.DataFrame, **values) -> pd.DataFrame:
    chosen = table
    for name, value in values.items():
        chosen = chosen[chosen[name] == value]
    return chosen


def test_planted_differences_are_in_the_table_and_no_others_are_found():
    rng = np.random.default_rng(0)
    effects = {"full": 0.0, "matte": -0.5, "same": 0.0}
    table = compare(pd.concat([scores_of(rng, s, effects) for s in ("ann", "bob", "eve")]), "full")
    assert list(dict.fromkeys(table.subject)) == [ALL, "ann", "bob", "eve"]
    row = rows_of(table, subject=ALL, variant="matte", lit="all", metric="psnr_db").iloc[0]
    assert row.difference == pytest.approx(-0.5, abs=3 * 0.2 * math.sqrt(2 / 72))
    assert row.p_holm < 0.001 and row.new_p_value < 0.05 and row.subjects == 3 and row.images == 144
    assert rows_of(table, variant="same", metric="psnr_db").p_holm.min() > 0.05
    assert rows_of(table, variant="full").difference.isna().all()
    # The images differ by 3 dB, so the mean is uncertain; of the difference they are no part.
    assert row.mean_error > 3 * row.difference_error


def test_validation_images_do_not_count():
    scores = scores_of(np.random.default_rng(2), "ann", {"full": 0.0, "matte": -0.5})
    chosen_on = scores[scores.frame < 6].assign(frame=lambda t: t.frame + 100, test_frame=False, psnr_db=99.0)
    pd.testing.assert_frame_equal(compare(pd.concat([scores, chosen_on]), "full"), compare(scores, "full"))


def test_mean_over_subjects_counts_each_the_same():
    rng = np.random.default_rng(1)
    scores = pd.concat([scores_of(rng, "ann", {"full": 0.0}, 8), scores_of(rng, "bob", {"full": 10.0}, 24)])
    table = rows_of(compare(scores, "full"), lit="all", metric="psnr_db").set_index("subject")["mean"]
    per_subject = scores.groupby("subject").psnr_db.mean()
    assert table[ALL] == pytest.approx(per_subject.mean(), rel=1e-12)
    assert table["bob"] == pytest.approx(per_subject["bob"], rel=1e-12)


def test_images_are_paired_by_camera_and_frame_whatever_their_order():
    rng = np.random.default_rng(2)
    scores = scores_of(rng, "ann", {"full": 0.0, "matte": -0.5})
    expected = compare(scores, "full")
    pd.testing.assert_frame_equal(
        compare(pd.concat([scores[:48], scores[48:].sample(frac=1, random_state=3)]), "full"), expected
    )


def test_what_was_not_measured_is_empty_and_exact_matches_count_the_ceiling():
    scores = scores_of(np.random.default_rng(3), "ann", {"full": 0.0, "matte": -0.5})
    scores.loc[0, "psnr_db"] = math.inf
    table = compare(scores, "full")
    assert rows_of(table, metric="lpips")[["mean", "difference", "p_value", "p_holm"]].isna().all(axis=None)
    assert (rows_of(table, metric="lpips").images == 0).all()
    row = rows_of(table, variant="full", lit="all", metric="psnr_db").iloc[0]
    own = scores[scores.variant == "full"].psnr_db
    assert row["mean"] == pytest.approx((own[1:].sum() + PSNR_CEILING_DB) / len(own))


def test_a_subject_without_the_variant_does_not_count_for_it():
    rng = np.random.default_rng(4)
    scores = pd.concat([scores_of(rng, "ann", {"full": 0.0, "matte": -1.0}), scores_of(rng, "bob", {"full": 0.0})])
    table = compare(scores, "full")
    assert set(rows_of(table, variant="matte").subject) == {"ann"}
    assert set(rows_of(table, variant="full").subject) == {ALL, "ann", "bob"}


def test_no_baseline_or_other_images_are_refused():
    scores = scores_of(np.random.default_rng(5), "ann", {"full": 0.0, "matte": -1.0})
    with pytest.raises(InputError, match=r"ann: expected a variant 'other' to compare with, found full, matte"):
        compare(scores, "other")
    with pytest.raises(InputError, match=r"matte and full scored on the same images, found 47 and 48 images, 47 of"):
        compare(scores[:-1], "full")


def test_in_a_table_without_effects_anything_is_found_in_one_of_twenty():
    """Two subjects, three ablations, three lightings: eighteen correlated tests of a table."""
    rng, draws = np.random.default_rng(6), 60
    found = 0
    for _ in range(draws):
        effects = dict.fromkeys(("full", "a", "b", "c"), 0.0)
        table = compare(pd.concat([scores_of(rng, s, effects, 16) for s in ("ann", "bob")]), "full")
        found += (rows_of(table, subject=ALL).p_holm < 0.05).any()
    assert found / draws < 0.05 + 3 * math.sqrt(0.05 * 0.95 / draws)


def test_p_values_are_corrected_within_each_subject():
    """Holm by hand: the smaller of two is doubled, the larger is at least that; another subject changes nothing."""
    rng = np.random.default_rng(2)
    effects = {"full": 0.0, "matte": -0.05, "flat": 0.02}
    ann, bob = (scores_of(rng, subject, effects) for subject in ("ann", "bob"))
    together, alone = compare(pd.concat([ann, bob]), "full"), compare(ann, "full")
    for table in (together, alone):
        rows = table[(table.subject == "ann") & table.p_value.notna()]
        ordered = rows.sort_values("p_value")
        count, least, expected = len(ordered), 0.0, {}
        for place, (label, p) in enumerate(ordered.p_value.items()):
            least = expected[label] = max(least, min(1.0, (count - place) * p))
        assert count >= 2
        np.testing.assert_allclose(rows.p_holm, [expected[label] for label in rows.index], rtol=1e-12)
