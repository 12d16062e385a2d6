"""Style of all pictures: colours, header, panels, choice of panels, and reproducible files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.path import Path as MarkerPath
from matplotlib.ticker import MaxNLocator

from pipeline.base.files import written_whole
from pipeline.base.verdicts import Grade

INK, MUTED, FAINT = "#1c2026", "#626a76", "#d5d9df"

OBSERVED, PREDICTED, IGNORED = "#56b4e9", "#f0e442", "#d55e00"
PREDICTED_ON_WHITE = "#b3a600"
"""Colours of marks on dark images, and the one for predictions in legends, on white.

With `GRADE_COLORS` from Okabe and Ito's palette, told apart by colour-blind eyes.
"""

GRADE_COLORS: dict[Grade, str] = {"good": "#009e73", "weak": "#e69f00", "failed": "#d55e00"}
GRADE_INKS: dict[Grade, str] = {"good": INK, "weak": "#8f5f00", "failed": "#b04600"}
"""The same as text on white: contrast above 4.5."""

CROSSHAIR = MarkerPath([(-1, 0), (-0.35, 0), (0.35, 0), (1, 0), (0, -1), (0, -0.35), (0, 0.35), (0, 1)], [1, 2] * 4)
"""A cross with a hole: what is predicted to be in the middle stays visible."""

IGNORED_WEIGHT = 0.1
"""Weight in the robust fit below which an observation is shown as left out.

Residuals of 7 standard deviations have it.
"""

WIDEST_INCHES, DPI, MARGIN_INCHES, GAP_INCHES, BAR_INCHES = 13.0, 100, 0.12, 0.16, 0.5
TITLE_INCHES, LINE_INCHES, LEGEND_INCHES, CAPTION_INCHES = 0.38, 0.20, 0.26, 0.44

GRAY_LEVELS = 20
"""Of images under marks: more would be noise, which makes files large. Pages are read on phones."""

RC = {
    "font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK, "axes.labelcolor": INK,
    "axes.edgecolor": MUTED, "axes.linewidth": 0.6, "xtick.color": MUTED, "ytick.color": MUTED,
    "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False, "hatch.linewidth": 0.4,
}  # fmt: skip


@contextmanager
def picture(
    path: Path, size: tuple[float, float], title: str, notes: Sequence[str], legend: Sequence[Artist] = ()
) -> Iterator[Figure]:
    """Yield a figure with a header on top; write it to `path` as PNG when the block ends.

    Args:
        size: inches (width, height) left for the drawing below the header.
        notes: lines below the title: how to read the picture, factors, units.
        legend: labelled artists, in one row below the notes.
    """
    header = TITLE_INCHES + LINE_INCHES * len(notes) + (LEGEND_INCHES if legend else 0)
    width, height = size[0], size[1] + header
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
        figure.subplots_adjust(0, 0, 1, size[1] / height)
        left = MARGIN_INCHES / width
        figure.text(left, 1 - 0.12 / height, title, size=13, weight="bold", va="top")
        for k, note in enumerate(notes):
            y = 1 - (TITLE_INCHES + k * LINE_INCHES) / height
            figure.text(left, y, note, color=MUTED, size=9, va="top")
        if legend:
            anchor = (left, 1 - (TITLE_INCHES + len(notes) * LINE_INCHES + 0.07) / height)
            figure.legend(
                handles=list(legend), loc="upper left", bbox_to_anchor=anchor, ncols=len(legend), borderaxespad=0,
                borderpad=0, handletextpad=0.4, columnspacing=1.8, fontsize=9,
            )  # fmt: skip
        yield figure
        _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    """Without matplotlib's version in the file: the same picture is the same bytes."""
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def grid_size(count: int, panel: tuple[float, float]) -> tuple[tuple[float, float], int]:
    """Size of a grid of `count` panels in inches, and its number of columns.

    `panel` is the size of one in inches, width and height.
    """
    most = max(1, int((WIDEST_INCHES - MARGIN_INCHES) // (panel[0] + GAP_INCHES)))
    rows = math.ceil(count / most)
    columns = math.ceil(count / rows)
    width = 2 * MARGIN_INCHES + columns * (panel[0] + GAP_INCHES) - GAP_INCHES
    # Not so narrow that the header's lines do not fit.
    return (max(width, 9.5), MARGIN_INCHES + rows * (panel[1] + CAPTION_INCHES)), columns


def add_panels(figure: Figure, count: int, panel: tuple[float, float], columns: int) -> list[Axes]:
    """Axes of `panel` inches (width, height), row by row, below the header.

    Above each is room for captions.
    """
    width, height = figure.get_size_inches()
    top = figure.subplotpars.top * height
    axes = []
    for k in range(count):
        row, column = divmod(k, columns)
        left, bottom = MARGIN_INCHES + column * (panel[0] + GAP_INCHES), top - (row + 1) * (panel[1] + CAPTION_INCHES)
        axes.append(figure.add_axes((left / width, bottom / height, panel[0] / width, panel[1] / height)))
    return axes


def frame_panel(axes: Axes, name: str, detail: str, grade: Grade = "good") -> None:
    """Put a thin frame without ticks round a panel, and its name and numbers above it.

    The name comes with its grade if that is not good.
    """
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(visible=True, color=FAINT if grade == "good" else GRADE_COLORS[grade])
    axes.spines[:].set_linewidth(0.8 if grade == "good" else 2.0)
    shown = name if grade == "good" else f"{name}: {grade}"
    caption = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "baseline"}
    axes.annotate(shown, (0, 1), (0, 14), weight="bold", color=GRADE_INKS[grade], **caption)
    axes.annotate(detail, (0, 1), (0, 4), size=7.5, color=MUTED, **caption)


def add_color_bar(figure: Figure, scale: Normalize, colors: str | Colormap, label: str) -> None:
    """Add a flat colour bar in the lower left corner, with its label to the right.

    With its numbers it is `BAR_INCHES` high.
    """
    width, height = figure.get_size_inches()
    axes = figure.add_axes((MARGIN_INCHES / width, 0.27 / height, 2.2 / width, 0.11 / height))
    ticks = MaxNLocator(5, integer=scale.vmax > 1)
    figure.colorbar(ScalarMappable(scale, colors), cax=axes, orientation="horizontal", ticks=ticks)
    figure.text((MARGIN_INCHES + 2.4) / width, 0.325 / height, label, va="center")


def show_gray(axes: Axes, image: np.ndarray, corner: tuple[int, int], dark: float, white: float) -> None:
    """Show grey pixels [height, width] in `GRAY_LEVELS`.

    The first pixel has its outer corner at `corner` (x, y).
    """
    (x, y), (height, width) = corner, image.shape
    box = axes.get_window_extent()
    scale = min(1.0, max(box.width / width, box.height / height))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    level = np.round(np.clip((small - dark) / (white - dark), 0, 1) * (GRAY_LEVELS - 1)) / (GRAY_LEVELS - 1)
    extent = (x, x + width, y + height, y)
    axes.imshow(level, extent=extent, aspect="equal", interpolation="nearest", cmap="gray", vmin=0, vmax=1)


def worst(scores: Mapping[str, float], grades: Mapping[str, Grade], most: int) -> list[str]:
    """The `most` names of the worst grade and, among equals, the highest score, sorted by name."""
    order = ("failed", "weak", "good")
    ranked = sorted(scores, key=lambda name: (order.index(grades.get(name, "good")), -scores[name], name))
    return sorted(ranked[:most])


def shown_count(shown: int, total: int, what: str) -> str:
    """'all 12 cameras', or 'the 24 worst of 160 cameras'."""
    return f"all {total} {what}" if shown == total else f"the {shown} worst of {total} {what}"


def round_factor(factor: float) -> float:
    """The largest of 1, 2, 5, 10, 20, 50 ... up to `factor`, at least 1.

    A magnification by such a factor can be undone in the head.
    """
    if factor <= 1:
        return 1.0
    power = 10.0 ** math.floor(math.log10(factor))
    return power * max(step for step in (1, 2, 5) if step * power <= factor * (1 + 1e-9))


def rms(residual: np.ndarray) -> float:
    """Root mean square length of residual vectors [n, components]."""
    return float(np.sqrt((residual**2).sum(1).mean()))
