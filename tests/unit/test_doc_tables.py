"""Tables and pictures that are written into the documentation, from results made up for them."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd

from docs.generate import (
    comparison_table,
    curves_figure,
    effects_table,
    error_budget_table,
    papers_dials,
    results_table,
    scaling_table,
)
from pipeline.base.files import write_json, write_table
from tests.support.results.curve_files import CURVES, write_subjects


def page_with_marks(path, name):
    path.write_text(f"<!-- {name}: begin -->\n<!-- {name}: end -->\n")
    return path


def test_comparison_has_a_row_for_each_avatar_and_none_for_their_mean(tmp_path):
    rows = [
        {"subject": subject, "variant": variant, "baseline": "full", "lit": lit, "metric": metric, "images": 7,
         "mean": mean, "mean_error": 0.25, "difference": mean - 31 if variant == "pbr" else None,
         "difference_error": 0.5}
        for subject in ("all", "ann") for variant, psnr in (("full", 31.0), ("pbr", 29.5)) for lit in ("all", "partial")
        for metric, mean in (("psnr_db", psnr - (lit == "partial")), ("ssim", 0.9), ("flip", 0.1))
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(tmp_path / "comparison.csv")
    page = page_with_marks(tmp_path / "page.md", "comparison")
    comparison_table.run(comparison=tmp_path / "comparison.csv", page=page)
    assert page.read_text().splitlines()[1:-1] == [
        "| subject | variant | images | PSNR, dB | partially lit | against `full` | SSIM | FLIP |",
        "|---|---|---|---|---|---|---|---|",
        "| `ann` | `full` | 7 | 31.00 ± 0.25 | 30.00 ± 0.25 |  | 0.900 | 0.100 |",
        "| `ann` | `pbr` | 7 | 29.50 ± 0.25 | 28.50 ± 0.25 | -1.50 ± 0.50 | 0.900 | 0.100 |",
    ]


def test_error_budgets_have_a_row_and_a_picture_per_subject(tmp_path):
    folders = []
    for name, lost in {"ann": 1.0, "bob": 0.25}.items():
        folders.append(tmp_path / "results" / name)
        budget = {
            "step": ["all true", "our color"],
            "test_all_db": [33.0, 33.0 - lost],
            "test_partial_db": [31.0, 30.5],
        }
        write_table(folders[-1] / "error_budget/error_budget.csv", pd.DataFrame(budget))
        (folders[-1] / "error_budget/error_budget.png").write_bytes(name.encode())
    (tmp_path / "docs/pictures").mkdir(parents=True)
    page = page_with_marks(tmp_path / "docs/page.md", "error budgets")
    error_budget_table.run(results=tuple(folders), page=page)
    assert page.read_text().splitlines()[1:-1] == [
        "| subject | all true | our color | lost |",
        "|---|---|---|---|",
        "| `ann` | 33.00 (31.00) | 32.00 (30.50) | 1.00 |",
        "| `bob` | 33.00 (31.00) | 32.75 (30.50) | 0.25 |",
        "",
        "![ann: what each input costs](pictures/error_budget_ann.png)",
        "",
        "![bob: what each input costs](pictures/error_budget_bob.png)",
    ]
    assert (tmp_path / "docs/pictures/error_budget_bob.png").read_bytes() == b"bob"


def test_effects_are_compared_by_scene_and_in_the_median(tmp_path):
    rows = [
        ("dull", "everything", "specular shadow", 30.0, 0.0, 1.0, "a"), ("dull", "full", None, 30.25, -0.25, 0.5, "a"),
        ("dull", "auto", None, 31.0, -1.0, 0.05, "a"), ("dull", "not_shadow", None, 30.9, -0.9, 0.1, "a"),
        ("dull", "not_specular", None, 31.2, -1.2, 0.1, "a"),
        ("shiny", "everything", "specular shadow", 28.0, 0.0, 1.0, "a"),
        ("shiny", "full", "specular near_field", 27.75, 0.25, 0.7, "a"),
        ("shiny", "auto", "specular near_field", 29.0, -1.0, 0.25, "a"),
        ("shiny", "half", "specular near_field", 28.5, -0.5, 0.125, "a"),
    ]  # fmt: skip
    columns = ["scene", "avatar", "effects", "psnr_db", "psnr_lost_db", "cpu_ratio", "draw"]
    pd.DataFrame(rows, columns=columns).to_csv(tmp_path / "table.csv")
    again = [row for row in rows if row[0] == "dull" and not row[1].startswith("not")]
    again = [(*row[:4], 2 * row[4], row[5], "b") for row in again]
    pd.DataFrame(again, columns=columns).to_csv(tmp_path / "again.csv")
    page = page_with_marks(tmp_path / "page.md", "effects comparison")
    page.write_text(page.read_text() + page_with_marks(tmp_path / "other.md", "effects turned round").read_text())
    effects_table.run(comparison=(tmp_path / "table.csv", tmp_path / "again.csv"), page=page)
    lines = page.read_text().splitlines()
    assert lines[3:6] == [
        # Of 0.25 and 0.5 dB, and of 1 and 2 dB, half the difference is the standard error.
        "| dull | none | 30.00 dB | +0.38 ± 0.12 dB | 50 % | +1.50 ± 0.50 dB | 5.0 % | - | - |",
        "| shiny | specular, near field | 28.00 dB | -0.25 dB | 70 % | +1.00 dB | 25 % | +0.50 dB | 12 % |",
        "| median |  |  | +0.06 dB | 60 % | +1.25 dB | 15 % | +0.50 dB | 12 % |",
    ]
    assert lines[8:-1] == [
        "| scene | shadow | specular |",
        "|---|---|---|",
        "| dull | off, turned -0.10 dB | off, turned +0.20 dB |",
        "| shiny | - | - |",
    ]


def test_scaling_has_a_row_per_cost_and_no_exponent_where_none_is_told(tmp_path):
    row = {"stage": "track_mesh", "varied": "frames", "cost": "CPU seconds", "smallest": 8, "largest": 4096.0,
           "predicted": 1.0, "exponent": 0.98, "low": 0.9, "high": 1.06, "verdict": "as predicted"}  # fmt: skip
    flat = row | {"cost": "peak MB", "predicted": 0.0, "exponent": np.nan, "verdict": "cannot tell"}
    write_table(tmp_path / "scaling/exponents.csv", pd.DataFrame([row, flat]))
    (tmp_path / "scaling/scaling.png").write_bytes(b"png")
    (tmp_path / "pictures").mkdir()
    page = page_with_marks(tmp_path / "page.md", "scaling")
    scaling_table.run(results=tmp_path / "scaling", page=page)
    assert page.read_text().splitlines()[3:-1] == [
        "| `track_mesh` | frames | CPU seconds | 8 | 4,096 | 1 | 0.98 (0.90 to 1.06) | as predicted |",
        "| `track_mesh` | frames | peak MB | 8 | 4,096 | 0 |  | cannot tell |",
    ]
    assert (tmp_path / "pictures/scaling.png").exists()


def test_papers_dials_have_their_reference_first_and_a_line_per_value(tmp_path):
    lost, picture = "PSNR lost on validation images, partial lit, dB (reference 16)", "time of a picture, ms"
    measured = {
        "imports only": (2.0, {lost: (np.nan, np.nan)}),
        "8": (20.0, {lost: (0.251, 0.0149), picture: (40.4, np.nan)}),
        "16": (25.0, {lost: (0.0, 0.0), picture: (50.0, np.nan)}),
    }
    rows = [
        {"dial": "code_size", "setting": setting, "metric": metric, "error": error, "standard_error": scatter,
         "cpu_seconds": seconds}
        for setting, (seconds, metrics) in measured.items() for metric, (error, scatter) in metrics.items()
    ]  # fmt: skip
    write_table(tmp_path / "one/accuracy_cost.csv", pd.DataFrame([*rows, rows[-1] | {"dial": "texel_size"}]))
    page = page_with_marks(tmp_path / "page.md", "papers' dials")
    papers_dials.run(costs=(tmp_path / "one/accuracy_cost.csv",), page=page)
    assert page.read_text().splitlines()[3:-1] == [
        "| `one` | `code_size` | `16` |  | 25 | 1.00 | 50 |",
        "| `one` | `code_size` | `8` | 0.25 ± 0.01 | 20 | 0.80 | 40 |",
    ]


def test_row_of_results_repeats_the_scores_of_all_held_out_images(tmp_path):
    scores = {"psnr_db": [20.0, 25.0, 30.0], "ssim": 0.9, "flip": 0.1, "images": 7, "lit": ["all", "full", "partial"]}
    pd.DataFrame(scores | {"subject": "one", "variant": "full", "split": "test"}).to_csv(tmp_path / "metrics.csv")
    for name, count in {"cameras": 3, "lights": 4, "frames": 5}.items():
        write_table(tmp_path / f"index/{name}.parquet", pd.DataFrame({"number": range(count)}))
    write_json(tmp_path / "index/capture.json", {"kind": "head"})
    (tmp_path / "benchmarks").mkdir()
    jobs = {"track_mesh.0000": 60, "train_avatar.full": 120, "train_avatar.other": 600, "write_report": 60}
    for job, seconds in jobs.items():
        (tmp_path / f"benchmarks/{job}.tsv").write_text(f"s\tcpu_time\n{seconds}\t1\n")
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- results: begin -->\n| a |\n|---|\n| `none` | kept |\n<!-- results: end -->\nafter\n")
    results_table.run(results=(tmp_path,), page=page)
    text = page.read_text()
    assert "| `one` | head: 3 cameras, 4 lights, 5 frames | 7 | 20.00 | 25.00 | 30.00 | 0.900 | 0.100 | 3 |" in text
    assert "| `none` | kept |" in text and text.endswith("after\n")


def test_curves_are_drawn_in_a_panel_per_dial_and_a_line_per_subject(tmp_path):
    curves = write_subjects(tmp_path / "curves", {"ann": CURVES, "bob": CURVES})
    curves_figure.run(curves=curves, out=tmp_path / "curves.png")
    picture = cv2.imread(str(tmp_path / "curves.png")).astype(int)
    # Both subjects have the same curves, so that the second one's hide the first's but in the legend.
    first, second = (
        np.abs(picture[..., ::-1] - [int(color[at : at + 2], 16) for at in (1, 3, 5)]).max(-1) < 8
        for color in curves_figure.COLORS[:2]
    )
    height = len(picture)
    assert first[: height // 3].any() and not first[height // 3 :].any()
    rows = np.flatnonzero(second.any(1))
    assert rows.max() > 0.6 * height  # two rows of panels
