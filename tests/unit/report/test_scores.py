"""The tables of RGCA in a report: a split that holds images has one, with what a picture of each avatar takes."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

from pipeline.report.scores import held_out_tables


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
