"""Draw what a person judges the calibration by.

It writes verdicts, one table of all residuals, pictures, and a page of them.

Nothing here changes the calibration. Pictures for which a capture has nothing (known cameras, known lights, no chart)
are left out, and the page says why.
"""

from __future__ import annotations

import logging
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.files import write_table
from pipeline.base.verdicts import log_verdicts, verdict_table
from pipeline.base.whole_files import written_folder
from pipeline.calibration.color.chart_images import ChartFormat
from pipeline.calibration.color.chart_layout import ChartLayout
from pipeline.calibration.lights.ball_photos import find_outlines
from pipeline.capture.gray import read_view_gray
from pipeline.config.review_calibration import ReviewCalibration
from pipeline.figures.balls import BallView, draw_balls, read_ball_view
from pipeline.figures.calibration import PATCH_CORNERS, Calibration, read_calibration, residual_table
from pipeline.figures.charts import Chart, average_colors, difference, draw_charts, upright
from pipeline.figures.corners import BoardView, draw_corners, worst_view
from pipeline.figures.coverage import draw_coverage
from pipeline.figures.page import Section, write_page
from pipeline.figures.residual_arrows import draw_residuals
from pipeline.figures.residual_histogram import draw_histogram
from pipeline.figures.rig import Stage, draw_rig
from pipeline.figures.style import rms, shown_count, worst
from pipeline.figures.targets import Outlines, locate_balls, locate_boards

log = logging.getLogger("review_calibration")


def run(
    *, capture: Path, index: Path, calibration: Path, out: Path, threads: int = 1,
    settings: ReviewCalibration = ReviewCalibration(),
) -> None:  # fmt: skip
    """Gather verdicts and residuals of the calibration and draw what they mean.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        calibration: folder that the calibrating stages wrote.
        out: folder to write residuals.parquet, verdicts.csv and the folder review to.
        threads: images read at a time.
    """
    found = read_calibration(index, calibration)
    log_verdicts(log, found.verdicts)
    residuals = residual_table(found)
    with ThreadPoolExecutor(threads) as pool, written_folder(out / "review", "review_calibration") as folder:
        used = found.grades("ball")
        outlines = {key: outline for key, outline in find_outlines(capture, found.balls)[0].items() if key[0] in used}
        sections = [
            show_stage(folder, found, outlines),
            *show_boards(folder, capture, found, settings, pool),
            show_balls(folder, capture, found, outlines, settings, pool),
            show_charts(folder, capture, found, settings, pool),
            show_histogram(folder, residuals),
        ]
        write_page(folder / "index.html", f"Calibration of {found.subject}", found.verdicts, sections)
    write_table(out / "residuals.parquet", residuals)
    write_table(out / "verdicts.csv", verdict_table(found.verdicts))


def show_stage(folder: Path, found: Calibration, outlines: Outlines) -> Section:
    """rig.png."""
    balls = locate_balls(outlines, found.cameras, found.balls["radius_m"]) if outlines else {}
    shown = len(found.corners) and found.boards["method"] != "features"
    boards = locate_boards(found.corners, found.cameras) if shown else []
    grades = {(verdict.kind, verdict.name): verdict.grade for verdict in found.verdicts}
    radius_m = found.balls.get("radius_m", 0.0)
    draw_rig(
        folder / "rig.png", Stage(found.cameras, found.lights, found.survey, balls, radius_m, boards), grades
    )  # fmt: skip
    return Section("The stage", "rig.png", "Do cameras and lights stand where they stand in the room?")


def show_boards(
    folder: Path, capture: Path, found: Calibration, settings: ReviewCalibration, pool: Executor
) -> list[Section]:
    """corners.png, coverage.png and residuals.png."""
    if not len(found.corners):
        reason = f"The method is {found.boards['method']}: no board was looked for, so there is nothing to show."
        return [Section("Board corners, coverage and residuals", "", reason)]
    tables = dict(list(found.corners.groupby("camera")))
    scores = {name: rms(table[["residual_x", "residual_y"]].to_numpy()) for name, table in tables.items()}
    grades = found.grades("camera")
    names = worst(scores, grades, settings.most_panels)
    which = shown_count(len(names), len(scores), "cameras")
    views = {name: worst_view(tables[name]) for name in names}
    entries = {(entry["camera"], entry["view"]): entry for entry in found.boards["views"]}
    images = pool.map(lambda name: read_view_gray(capture, entries[name, views[name]]), names)
    panels = [
        BoardView(name, image, tables[name][tables[name]["view"] == views[name]])
        for name, image in zip(names, images, strict=True)
    ]
    draw_corners(folder / "corners.png", panels, grades, which)
    draw_coverage(folder / "coverage.png", found.corners, found.cameras, names, grades, which)
    draw_residuals(folder / "residuals.png", found.corners, found.cameras, names, grades, which)
    if found.boards["method"] == "features":
        return [
            Section(
                "Features", "corners.png", "Do points of the subject that cameras share project to where they are?"
            ),
            Section("Coverage", "coverage.png", "Does the subject show features wherever the lens has to be known?"),
            Section("Residuals", "residuals.png", "Is what is left over random, or has it a pattern?"),
        ]
    return [
        Section("Board corners", "corners.png", "Are corners found where they are, and do projections hit them?"),
        Section("Coverage", "coverage.png", "Was the board recorded wherever the lens has to be known?"),
        Section("Corner residuals", "residuals.png", "Is what is left over random, or has it a pattern?"),
    ]


def show_balls(
    folder: Path, capture: Path, found: Calibration, outlines: Outlines, settings: ReviewCalibration, pool: Executor
) -> Section:
    """balls.png."""
    if not outlines:
        reason = f"The method is {found.balls['method']}: there are no images of a mirror ball to show."
        return Section("Mirror balls", "", reason)
    none = found.highlights.iloc[:0]
    tables = dict.fromkeys(outlines, none) | dict(list(found.highlights.groupby(["position", "camera"])))
    lit = {(entry["position"], entry["camera"], entry["light"]): entry["path"] for entry in found.balls["images"]}
    titles = {f"{camera}, ball {position}": (position, camera) for position, camera in outlines}
    scores = {
        title: rms(tables[key][["residual_x", "residual_y"]].to_numpy()) if len(tables[key]) else 0.0
        for title, key in titles.items()
    }
    names = worst(scores, {}, settings.most_panels)

    def read(title: str) -> BallView:
        key, table = titles[title], tables[titles[title]]
        length = np.hypot(table.residual_x, table.residual_y)
        shown = table.light.loc[length.sort_values(ascending=False).index][: settings.lit_images]
        paths = [capture / lit[(*key, light)] for light in shown]
        return read_ball_view(title, outlines[key], paths, found.balls.get("transfer", "linear"), table)

    which = shown_count(len(names), len(scores), "views of balls")
    draw_balls(folder / "balls.png", list(pool.map(read, names)), found.grades("light"), which)
    return Section("Mirror balls", "balls.png", "Is each highlight found on the ball, and where its light predicts it?")


def show_charts(
    folder: Path, capture: Path, found: Calibration, settings: ReviewCalibration, pool: Executor
) -> Section:
    """charts.png."""
    if not len(found.patches):
        reason = f"The method is {found.charts['method']}: no chart was recorded, so there is nothing to show."
        return Section("Colour charts", "", reason)
    tables = {name: table.sort_values("patch") for name, table in found.patches.groupby("camera")}
    colors = {name: table[["r", "g", "b"]].to_numpy(np.float64) for name, table in tables.items()}
    target = average_colors(found.patches, found.corrections)
    scores = {name: difference(color @ found.corrections[name].T, target) for name, color in colors.items()}
    names = worst(scores, found.grades("color"), settings.most_panels)
    paths = {entry["camera"]: capture / entry["path"] for entry in found.charts["images"]}

    layout = ChartLayout.from_index(found.charts)

    def read(name: str) -> Chart:
        image = ChartFormat.from_index(found.charts, found.black_level).read(paths[name])
        centers = tables[name][PATCH_CORNERS].to_numpy(np.float64).reshape(-1, 4, 2).mean(1)
        return Chart(name, upright(image, centers, layout), colors[name], found.corrections[name], layout)

    which = shown_count(len(names), len(scores), "cameras")
    draw_charts(folder / "charts.png", list(pool.map(read, names)), target, found.grades("color"), which)
    return Section("Colour charts", "charts.png", "Do all cameras show the chart in the same colours, once corrected?")


def show_histogram(folder: Path, residuals: pd.DataFrame) -> Section:
    """residual_histogram.png."""
    title = "Residuals against their predicted spread"
    if not len(residuals):
        return Section(title, "", "Nothing was measured, so there are no residuals.")
    draw_histogram(folder / "residual_histogram.png", residuals)
    return Section(title, "residual_histogram.png", "Is the noise what the fit took it for, with few gross mistakes?")


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
