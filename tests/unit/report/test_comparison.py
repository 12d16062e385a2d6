"""The overview of a comparison: one number per avatar and subject, of all images."""

from __future__ import annotations

import re

import pandas as pd

from pipeline.metrics.ablation_table import ALL
from pipeline.report.comparison import overview


def test_overview_has_the_decibels_of_all_light_and_no_other_metric():
    decibels = {("ann", "full"): 31.0, ("ann", "matte"): 29.5, (ALL, "full"): 30.0}
    rows = []
    for (subject, variant), value in decibels.items():
        for metric, lit, shift in (("psnr_db", "full", 2.0), ("psnr_db", "all", 0.0), ("psnr_db", "partial", -3.0)):
            row = {"subject": subject, "variant": variant, "lit": lit, "metric": metric}
            rows.append(row | {"mean": value + shift, "mean_error": 0.25})
        rows.append({"subject": subject, "variant": variant, "lit": "all", "metric": "ssim", "mean": 0.9})
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", overview(pd.DataFrame(rows)).html)
    assert cells == ["full", "31.00 ± 0.25", "30.00 ± 0.25", "matte", "29.50 ± 0.25", "–"]
