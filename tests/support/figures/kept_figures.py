"""Figures that are kept as they are written, so that a test sees the marks on them and not only pixels."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from pipeline.figures import style


@contextmanager
def kept_figures() -> Iterator[dict[str, Figure]]:
    """File's name -> figure, of all pictures that are written within the block."""
    kept: dict[str, Figure] = {}
    save = style._save

    def keep(figure: Figure, path: Path) -> None:
        kept[path.name] = figure
        save(figure, path)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "_save", keep)
        yield kept


def points(axes: Axes) -> np.ndarray:
    """All points of all lines in data's coordinates, [n, 2]; those that are NaN left out."""
    found = [np.empty((0, 2)), *(np.asarray(line.get_xydata(), np.float64) for line in axes.get_lines())]
    stacked = np.concatenate(found)
    return stacked[np.isfinite(stacked).all(1)]


def texts(figure: Figure) -> list[str]:
    """All that is written on a figure, on its panels too."""
    own = [*figure.texts, *(text for axes in figure.axes for text in [axes.title, *axes.texts])]
    return [text.get_text() for text in own if text.get_text()]


def panel_named(figure: Figure, name: str) -> Axes:
    """The first panel that says this in its title or a text of its own."""
    for axes in figure.axes:
        if any(name in text.get_text() for text in [axes.title, *axes.texts]):
            return axes
    raise AssertionError(f"no panel says {name!r}; they say {texts(figure)}")


def bars(axes: Axes) -> list[tuple[float, float, str]]:
    """Left end, width and colour of each horizontal bar, from the first drawn."""
    return [(bar.get_x(), bar.get_width(), to_hex(bar.get_facecolor())) for bar in axes.patches]
