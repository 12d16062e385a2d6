"""Scores of the avatars on images that they have never seen, and pictures of these."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.splits import VALIDATION
from pipeline.metrics.ablation_table import compare
from pipeline.metrics.comparison import split_picture
from pipeline.metrics.evaluation import (
    LIT,
    PSNR_CEILING_DB,
    SPLITS,
    TABLES,
    worst_median_best,
)
from pipeline.metrics.image_metrics import IMAGE_METRICS, metrics_in
from pipeline.metrics.significance import BLOCKS, mean_over_images
from pipeline.report.part import Part
from pipeline.report.results import Results
from pipeline.report.slider import compared, slider
from pipeline.report.tables import Html, folded, html_table, number, p_text, paragraph, significant

METRICS = {metric.name: metric for metric in IMAGE_METRICS}
SPLIT_NAMES = {
    "test": "all test images", VALIDATION: "validation images", "test_cameras": "new cameras",
    "test_frames": "new frames", "test_segments": "new segments", "test_patterns": "new patterns",
    "held_out_segments": "new segments, known cameras", "held_out_lights": "new light, known cameras and segments",
    "novel_view_and_pose": "new poses from new cameras", "novel_view_and_light": "new patterns from new cameras",
}  # fmt: skip
LIT_NAMES = {"all": "all light", "full": "fully lit", "partial": "partially lit"}
SIGNIFICANT = 0.05

TESTED = (
    "Differences are of the same images, avatar minus baseline. Images of a frame share pose and light, and frames "
    f"resemble their neighbours, so the standard error is that of up to {BLOCKS} blocks of frames in a row, and p "
    "comes from a t-test on the blocks (Ibragimov and Müller 2010): would the difference be there in other frames of "
    "this motion, seen by these cameras? p (Holm) is corrected for all tests of the table; below "
    f"{SIGNIFICANT:g} an avatar is called better or worse."
)


def headline(results: Results) -> Part:
    """Scores of the first avatar on tiles, all scores as tables, and the protocol."""
    metrics, images = results.csv("metrics.csv"), results.table("metrics_per_image.parquet")
    variants = list(dict.fromkeys(metrics.variant))
    tables = [_table(metrics[metrics.variant == name], name) for name in variants]
    more = "".join(
        folded(f"Scores of avatar {name}", table) for name, table in zip(variants[1:], tables[1:], strict=True)
    )
    return Part("Scores", _tiles(metrics, images, variants[0]) + tables[0] + more + _protocol(metrics))


def _tiles(metrics: pd.DataFrame, images: pd.DataFrame, variant: str) -> str:
    own, tiles = metrics[(metrics.variant == variant) & (metrics.lit == "all")].set_index("split"), []
    scored = images[images.variant == variant]
    scored = scored.assign(psnr_db=scored.psnr_db.clip(upper=PSNR_CEILING_DB))
    for split, title in SPLIT_NAMES.items():
        row, chosen = own.loc[split], scored[SPLITS[split](scored) & scored.psnr_db.notna()]
        if not row.images:
            continue
        error = mean_over_images(chosen.psnr_db.to_numpy(np.float64), chosen.frame.to_numpy()).error
        spread = f" ± {number(error)}" if math.isfinite(error) else ""
        tiles.append(
            f'<div class="tile score"><span>{title}</span><b class="value">{number(row.psnr_db)} dB</b>'
            f"<span>PSNR{spread}, {row.images} images</span></div>"
        )
    higher = [metric.title for metric in metrics_in(metrics) if metric.higher_is_better]
    note = (
        f"Avatar {variant}. ± is the standard error over frames. Better is higher for "
        f"{', '.join(higher[:-1])} and {higher[-1]}, lower for others."
    )
    return f'<div class="tiles">{"".join(tiles)}</div>{paragraph(note)}'


def _table(rows: pd.DataFrame, variant: str) -> Html:
    cells, empty = [], []
    metrics = [metric for metric in metrics_in(rows) if rows[metric.name].notna().any()]
    for split, title in SPLIT_NAMES.items():
        own = rows[rows.split == split].set_index("lit")
        if not own.images["all"]:
            empty.append(title)
            continue
        cells.append([title])
        for lit in LIT:
            row = own.loc[lit]
            cells.append([LIT_NAMES[lit], row.images, *(number(row[m.name], m.digits) for m in metrics)])
    head = ["light", "images", *(metric.heading for metric in metrics)]
    notes = [f"The capture holds out none of: {', '.join(empty)}."] if empty else []
    if METRICS["lpips"] not in metrics:
        notes.append(f"LPIPS was not measured: {str(rows.lpips_weights.iloc[0]).removeprefix('none: ')}.")
    table = html_table(f"scores of avatar {variant}", head, cells, "s" + "n" * (1 + len(metrics)))
    return Html(table + "".join(paragraph(note) for note in notes))


def _protocol(metrics: pd.DataFrame) -> str:
    row = metrics.iloc[0]
    lines = [
        f"Colour: {row.color_space}. Region: {row.region}.",
        f"LPIPS: network {row.lpips_net}, weights {row.lpips_weights}.",
    ]
    return folded("How it was scored", "".join(paragraph(line) for line in lines))


def pictures(results: Results) -> Part:
    """Sliders of the worst, the median and the best image of each avatar."""
    scored = results.table("metrics_per_image.parquet")
    variants, groups, absent = list(dict.fromkeys(scored.variant)), [], []
    for variant in variants[: results.settings.most_variants]:
        rows = worst_median_best(scored[scored.variant == variant])
        paths = {name: results.folder / f"images/{variant}_{name}.png" for name in rows}
        absent += [path.name for path in paths.values() if not path.is_file()]
        shown = [_slider(results, paths[name], name, row) for name, row in rows.items() if paths[name].is_file()]
        heading = f"<h3>Avatar {variant}</h3>" if len(variants) > 1 else ""
        groups.append(heading + compared(f"pair-{variant}", shown) if shown else "")
    missing = (
        f"pictures of evaluate_avatar ({', '.join(absent)}), which its setting pictures turns off" if absent else ""
    )
    left_out = variants[results.settings.most_variants :]
    note = paragraph(f"Not shown: {', '.join(left_out)} (most_variants).") if left_out else ""
    text = paragraph("Push the edge with the pointer, or with the arrow keys.")
    return Part("Captured and rendered", text + "".join(groups) + note, missing)


def _slider(results: Results, path: Path, name: str, row: pd.Series) -> str:
    picture = cv2.imread(str(path))
    if picture is None:
        raise InputError(f"{path}: expected a PNG picture of evaluate_avatar, found none that can be read")
    panels = split_picture(np.ascontiguousarray(picture[..., ::-1]))
    height, width = panels["captured"].shape[:2]
    uris = {panel: results.pictures.image_uri(np.ascontiguousarray(image)) for panel, image in panels.items()}
    light = LIT_NAMES["full" if row.fully_lit else "partial"]
    return slider(uris, width / height, f"{name}: {row.camera}, frame {row.frame}, {light}, {number(row.psnr_db)} dB")


def ablations(results: Results) -> Part:
    """Scores and costs of each avatar, and differences from the first beyond chance."""
    title, costs = "Ablations", results.csv("ablations.csv").merge(results.csv("avatar_times.csv"))
    if len(costs) < 2:
        return Part(title, "", "only one avatar was trained; variants in the subject's settings name more")
    scores = results.table("metrics_per_image.parquet")
    table = compare(scores, costs.variant[0])
    cost_rows = [
        [row.variant, f"{row.parameters:,}", number(row.training_seconds, 0), number(row.render_milliseconds, 1)]
        for row in costs.itertuples()
    ]
    head = ["avatar", "parameters", "training [s]", "one picture [ms]"]
    tables = html_table("costs of avatars", head, cost_rows, "snnn") + held_out_tables(
        results.csv("metrics.csv"), costs
    )
    return Part(title, tables + paragraph(TESTED) + differences(table))


def held_out_tables(metrics: pd.DataFrame, costs: pd.DataFrame) -> str:
    """Tables of scores, one per split of the papers' tables that holds images.

    Each avatar has its scores and the time of a picture.
    """
    tables, milliseconds = "", costs.set_index("variant").render_milliseconds
    scored = metrics_in(metrics)
    for split in TABLES:
        own = metrics[(metrics.split == split) & (metrics.lit == "all") & (metrics.images > 0)]
        if own.empty:
            continue
        rows = [
            [row.variant, *(number(getattr(row, metric.name), metric.digits) for metric in scored),
             number(milliseconds[row.variant], 1)]
            for row in own.itertuples()
        ]  # fmt: skip
        title = f"{SPLIT_NAMES[split]}, {own.images.iloc[0]} images"
        head = ["avatar", *(metric.heading for metric in scored), "one picture [ms]"]
        tables += paragraph(f"{title[0].upper()}{title[1:]}:") + html_table(
            title, head, rows, "s" + "n" * (1 + len(scored))
        )
    return tables


def differences(table: pd.DataFrame, subjects: bool = False) -> Html:
    """The table of `compare` as HTML; `subjects` adds what holds for new subjects."""
    rows, variant = [], None
    for row in table[table.images > 0].itertuples():
        metric, is_base = METRICS[row.metric], row.variant == row.baseline
        if row.variant != variant:
            variant = row.variant
            rows.append([f"{variant} (the baseline)" if is_base else f"{variant}, against {row.baseline}"])
        cells = [LIT_NAMES[row.lit], metric.heading]
        cells.append(f"{number(row.mean, metric.digits)} ± {number(row.mean_error, metric.digits)}")
        cells += ["", "", ""] if is_base else [_difference(row), p_text(row.p_value), _verdict(row, row.p_holm)]
        if subjects and is_base:
            cells += ["", "", "", row.subjects]
        elif subjects:
            cells += [f"± {significant(row.new_difference_error, 2)}", p_text(row.new_p_value)]
            cells += [_verdict(row, row.new_p_holm), row.subjects]
        rows.append([*cells, row.images])
    head = ["light", "metric", "mean", "difference", "p", "p (Holm)"]
    head += ["new subjects", "p", "p (Holm)", "subjects"] if subjects else []
    kinds = "ssnnns" + ("nnsn" if subjects else "") + "n"
    return html_table("differences of avatars", [*head, "images"], rows, kinds)


def _difference(row) -> str:
    return f"{number(row.difference, METRICS[row.metric].digits + 1, '+')} ± {significant(row.difference_error, 2)}"


def _verdict(row, corrected: float) -> Html:
    """The corrected p-value; in words whether the variant is better or worse, where that is significant."""
    if not corrected < SIGNIFICANT:
        return Html(p_text(corrected))
    better = (row.difference > 0) == METRICS[row.metric].higher_is_better
    return Html(f'{p_text(corrected).replace("<", "&lt;")} <b class="{"good" if better else "failed"}">'
                f'{"better" if better else "worse"}</b>')  # fmt: skip
