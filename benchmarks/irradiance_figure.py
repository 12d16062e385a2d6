"""Picture of docs/irradiance.md: error of an irradiance map against the time that it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.ticker import FuncFormatter, NullFormatter

from pipeline.figures.style import INK, MUTED, picture

SIZE_INCHES = (9.5, 3.6)


def draw_irradiance(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a PNG with a line for each number of lights, from one shared ray per texel to sixteen.

    Args:
        rows: lights, way, ms and picture_db of each way, as `benchmarks.bench_irradiance_cost` prints them.
    """
    notes = [
        "A line for each number of lights: 1, 2, 4, 8 and 16 rays per texel, shared with neighbours, as far as",
        "they take less time than all rays, which have no error: the marks on the upper edge.",
    ]
    with picture(path, SIZE_INCHES, "Irradiance maps: time against error", notes) as figure:
        width, height = figure.get_size_inches()
        axes = figure.add_axes((0.7 / width, 0.5 / height, 1 - 1.6 / width, (SIZE_INCHES[1] - 0.75) / height))
        counts = sorted({int(row["lights"]) for row in rows})
        colors = matplotlib.colormaps["viridis"]
        top = 50.0
        for place, count in enumerate(counts):
            mine = {str(row["way"]): row for row in rows if row["lights"] == count}
            whole = mine["all"]["ms"]
            drawn = [row for way, row in mine.items() if way.endswith("shared") and row["ms"] < whole]
            color = colors(0.9 * place / max(len(counts) - 1, 1))
            times = [row["ms"] for row in drawn]
            axes.plot(times, [row["picture_db"] for row in drawn], "o-", color=color, linewidth=1.2, markersize=4)
            axes.plot([whole], [top], "v", color=color, markersize=7, clip_on=False)
            axes.text(whole, top + 0.6, f"{count:,}", color=INK, ha="center", va="bottom")
        axes.set(xscale="log", ylim=(None, top), xlabel="ms of one processor for a map", ylabel="PSNR of pictures, dB")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.text(1.01, 1.0, "all rays,\nlights:", transform=axes.transAxes, color=MUTED, va="bottom")
