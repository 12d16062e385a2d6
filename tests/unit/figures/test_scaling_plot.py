"""The picture of scaling: every case has its panel, its exponents and its predictions, and a miss is bold."""

from __future__ import annotations

import matplotlib.axes
import pandas as pd
import pytest
from PIL import Image

from pipeline.figures.scaling_plot import draw_scaling

SIZES = (1, 2, 4, 8, 1_000_000)


def tables(stages):
    """Runs and exponents: time grows with the size, memory does not, against the prediction."""
    runs, exponents = [], []
    for stage in stages:
        case = {"stage": stage, "varied": "frames"}
        runs += [case | {"frames": n, "CPU seconds": 0.1 * n, "peak MB": 5.0} for n in SIZES]
        shared = case | {"smallest": SIZES[0], "largest": SIZES[-1], "predicted": 1.0}
        for cost, exponent, fixed, factor, verdict in (
            ("CPU seconds", 1.0, 0.0, 0.1, "as predicted"), ("peak MB", 0.0, 0.0, 5.0, "less than predicted")
        ):  # fmt: skip
            ends = {"low": exponent - 0.1, "high": exponent + 0.1}
            law = {"cost": cost, "exponent": exponent, "fixed": fixed, "factor": factor, "verdict": verdict}
            exponents.append(shared | law | ends)
    return pd.DataFrame(runs), pd.DataFrame(exponents)


@pytest.fixture
def drawn(monkeypatch):
    """(text, bold) of annotations, and the lines' end values, as the picture is drawn."""
    written, lines = [], []
    annotate, plot = matplotlib.axes.Axes.annotate, matplotlib.axes.Axes.plot

    def note(self, text, *args, **options):
        written.append((text, options.get("weight") == "bold"))
        return annotate(self, text, *args, **options)

    def line(self, x, y, *args, **options):
        lines.extend([min(y), max(y)])
        return plot(self, x, y, *args, **options)

    monkeypatch.setattr(matplotlib.axes.Axes, "annotate", note)
    monkeypatch.setattr(matplotlib.axes.Axes, "plot", line)
    return written, lines


def test_exponents_stand_over_their_panel_and_a_miss_is_bold(tmp_path, drawn):
    draw_scaling(tmp_path / "a.png", *tables(["one", "two"]))
    written, lines = drawn
    assert written.count(("CPU time 1.00 [0.90, 1.10] (1)", False)) == 2
    assert written.count(("memory 0.00 [-0.10, 0.10] (1)", True)) == 2
    assert {("one", True), ("two", True)} <= set(written)
    # Costs over that of the smallest size, and the law through them.
    assert lines == pytest.approx([1.0, 1e6, 1.0, 1e6, 1.0, 1.0, 1.0, 1.0] * 2)


def test_a_row_of_four_panels_and_then_another_and_the_same_bytes(tmp_path):
    heights = []
    for count in (1, 4, 5):
        draw_scaling(tmp_path / f"{count}.png", *tables([f"s{k}" for k in range(count)]))
        with Image.open(tmp_path / f"{count}.png") as image:
            heights.append(image.height)
    assert heights[0] == heights[1] < heights[2]
    draw_scaling(tmp_path / "again.png", *tables(["s0"]))
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "1.png").read_bytes()
