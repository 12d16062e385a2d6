"""Waterfall of decibels, from true inputs to those that were found."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.ticker import FormatStrFormatter

from pipeline.figures.style import GRADE_COLORS, INK, MUTED, picture

WIDTH_INCHES, ROW_INCHES, AXIS_INCHES, LEFT_INCHES, RIGHT_INCHES = 9.5, 0.42, 0.55, 1.4, 0.3

MARGIN_DB = 1.0
"""Beyond the smallest and largest number."""


def draw_waterfall(path: Path, table: pd.DataFrame, subject: str) -> None:
    """Write a PNG with a bar per step, from its PSNR of test images to that of the step before.

    Args:
        table: of error_budget.csv: step, test_all_db and test_partial_db.
        subject: for the title.
    """
    notes = [
        "First every input is true, then ours, one after the other from the top. Bars end at the PSNR of all test",
        "images, and say what the input costs; a line marks the PSNR of partially lit ones.",
    ]
    size = (WIDTH_INCHES, ROW_INCHES * len(table) + AXIS_INCHES)
    with picture(path, size, f"{subject}: what each input costs", notes) as figure:
        height = figure.get_size_inches()[1]
        area = (LEFT_INCHES, AXIS_INCHES, WIDTH_INCHES - LEFT_INCHES - RIGHT_INCHES, ROW_INCHES * len(table))
        axes = figure.add_axes((area[0] / WIDTH_INCHES, area[1] / height, area[2] / WIDTH_INCHES, area[3] / height))
        numbers = table[["test_all_db", "test_partial_db"]]
        low, high = float(numbers.min().min()) - MARGIN_DB, float(numbers.max().max()) + MARGIN_DB
        before = low
        for row, (all_db, partial_db) in enumerate(numbers.to_numpy()):
            color = MUTED if row == 0 else GRADE_COLORS["failed" if all_db < before else "good"]
            axes.barh(row, all_db - before, left=before, height=0.6, color=color)
            axes.vlines(partial_db, row - 0.3, row + 0.3, color=INK, linewidth=1.2)
            change = "" if row == 0 else f"  ({all_db - before:+.2f})"
            axes.text(max(all_db, before), row, f"  {all_db:.2f}{change}", va="center", color=INK)
            before = all_db
        axes.set(xlim=(low, high + MARGIN_DB), ylim=(len(table) - 0.5, -0.5), xlabel="PSNR, dB")
        axes.set_yticks(range(len(table)), table.step.tolist())
        axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
