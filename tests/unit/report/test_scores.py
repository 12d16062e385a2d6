"""The tables of RGCA in a report: a split that holds images has one, with what a picture of each avatar takes."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

from pipeline.report.scores import differences, held_out_tables


def test_splits_that_hold_images_have_a_table_with_the_time_of_a_picture():
    rows = []
    for variant, psnr in (("rgca", 31.234), ("linear", 29.876)):
        for split, images in (("test", 9), ("held_out_segments", 0), ("held_out_lights", 7)):
            scores = {"psnr_db": psnr if images else np.nan, "ssim": 0.9412, "lpips": np.nan, "flip": 0.0712}
            rows.append({"variant": variant, "split": split, "lit": "all", "images": images, **scores})
            rows.append(rows[-1] | {"lit": "partial", "psnr_db": 1.0})
    costs = pd.DataFrame({"variant": ["rgca", "linear"], "render_milliseconds": [41.26, 12.04]})
    tables = held_out_tables(pd.DataFrame(rows), costs)
    assert tables.count("<table>") == 1 and "New light, known cameras and segments, 7 images" in tables
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", tables)
    assert cells == ["rgca", "31.23", "0.941", "–", "0.071", "41.3", "linear", "29.88", "0.941", "–", "0.071", "12.0"]


def test_further_metric_has_a_column_where_it_was_scored():
    row = {"variant": "full", "split": "held_out_lights", "lit": "all", "images": 7, "psnr_db": 30.0, "ssim": 0.9}
    table = pd.DataFrame([row | {"lpips": 0.1, "flip": 0.1, "ms_ssim": 0.98765}])
    costs = pd.DataFrame({"variant": ["full"], "render_milliseconds": [1.0]})
    with_it, without = held_out_tables(table, costs), held_out_tables(table.drop(columns="ms_ssim"), costs)
    assert "MS-SSIM" in with_it and "0.988" in with_it
    assert "MS-SSIM" not in without and without.count("<th") == with_it.count("<th") - 1


def words_of(metric, difference, p_holm):
    """Columns of p (Holm) that the table of differences has for one avatar against the baseline."""
    row = {
        "subject": "someone", "variant": "matte", "baseline": "full", "lit": "all", "metric": metric, "subjects": 1,
        "images": 9, "mean": 1.0, "mean_error": 0.1, "difference": difference, "difference_error": 0.01,
        "p_value": p_holm / 2, "p_holm": p_holm,
    }  # fmt: skip
    return re.findall(r"<b[^>]*>(\w+)</b>", differences(pd.DataFrame([row])))


def test_avatar_is_called_better_by_what_the_metric_means():
    """More decibels and more similarity are better, less distance (LPIPS, FLIP) is."""
    for metric, up in (("psnr_db", "better"), ("ssim", "better"), ("lpips", "worse"), ("flip", "worse")):
        down = {"better": "worse", "worse": "better"}[up]
        assert words_of(metric, 0.3, 0.01) == [up]
        assert words_of(metric, -0.3, 0.01) == [down]
        assert words_of(metric, -0.3, 0.2) == []
