"""The picture of tables that have everything: errors of zero, settings that failed, names in one place."""

from __future__ import annotations

import warnings
from pathlib import Path

import matplotlib.axes
import pytest
from PIL import Image

from pipeline.figures.cost_plot import draw_costs
from pipeline.metrics.cost import IMPORTS_ONLY, Cost, cost_table


def costs(dial: str, settings: dict[str, tuple[float, float | None]], tolerance: float = 0.1) -> list[Cost]:
    """Setting -> seconds and error; with the imports."""
    return [
        Cost(dial, name, {"miss, mm": tolerance, "other": 1.0}, "steps", seconds=[seconds, 1.1 * seconds],
             cpu_seconds=[seconds], peak_mb=[9.0], errors={} if error is None else {"miss, mm": [error]})
        for name, (seconds, error) in {IMPORTS_ONLY: (1.0, None), **settings}.items()
    ]  # fmt: skip


@pytest.fixture
def annotated(monkeypatch):
    """(text, bold) of everything written beside a point, as the picture is drawn."""
    written = []
    original = matplotlib.axes.Axes.annotate

    def annotate(self, text, *args, **options):
        written.append((text, options.get("weight") == "bold"))
        return original(self, text, *args, **options)

    monkeypatch.setattr(matplotlib.axes.Axes, "annotate", annotate)
    return written


def draw(path: Path, rows: list[Cost]) -> Image.Image:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_costs(path, cost_table(rows, 0.1), 3)
    return Image.open(path)


def test_every_setting_is_named_and_the_chosen_one_is_bold(tmp_path, annotated) -> None:
    rows = costs("rounds", {"one": (2.0, 9.0), "two": (4.0, 1.04), "three": (8.0, 1.0), "four": (9.0, None)})
    draw(tmp_path / "a.png", [*rows, *costs("same", {"a": (2.0, 1.0), "b": (2.0, 1.0)})])
    assert ("two", True) in annotated
    assert {("one", False), ("three", False), ("miss, mm; failed: four", False)} <= set(annotated)
    assert {text for text, _ in annotated} >= {"rounds", "same", "a", "b"}
    assert "other" not in {text for text, _ in annotated}


def test_error_of_zero_is_shown_and_said(tmp_path, annotated) -> None:
    draw(tmp_path / "a.png", costs("samples", {"1": (2.0, 0.5), "full": (20.0, 0.0)}, tolerance=0.0))
    assert ("full (error 0)", True) in annotated


def test_dial_whose_settings_all_failed(tmp_path, annotated) -> None:
    draw(tmp_path / "a.png", costs("hopeless", {"1": (2.0, None), "2": (3.0, None)}))
    assert ("miss, mm; failed: 1, 2", False) in annotated


def test_a_row_of_three_dials_and_then_another_row(tmp_path) -> None:
    heights = [
        draw(tmp_path / f"{n}.png", [cost for k in range(n) for cost in costs(f"d{k}", {"1": (2.0, 1.0)})]).height
        for n in (1, 3, 4)
    ]
    assert heights[0] == heights[1] < heights[2]


def test_same_table_same_bytes(tmp_path) -> None:
    for name in ("a.png", "b.png"):
        draw(tmp_path / name, costs("rounds", {"1": (2.0, 1.0), "2": (3.0, 0.5)}))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
