"""Charts and mirror balls that others photographed: writes docs/photographed_targets.md and its picture.

    python -m benchmarks.bench_photographed_targets --data ../shared/data

The photographs stay outside of the repository: the picture shows numbers alone.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D

from benchmarks.marked_page import paragraphs
from benchmarks.photographed_targets import (
    FILTERS_NM,
    angles_deg,
    find_labelled_chart,
    probe_directions,
    published_directions,
    read_series,
    series_linearity,
)
from pipeline.calibration.color.sensor_linearity import Linearity
from pipeline.config.calibrate_color import CalibrateColor
from pipeline.figures.style import FAINT, GRADE_COLORS, INK, MUTED, picture

PAGE = Path("docs/photographed_targets.md")
PICTURE = Path("docs/pictures/sensor_linearity.png")

COLORS = dict(zip(FILTERS_NM, (MUTED, GRADE_COLORS["good"], GRADE_COLORS["failed"]), strict=True))

HEAD = """\
Photographs of calibration targets by others, measured by this pipeline. They are not part of the repository.
"""

SENSOR = """\
A colour chart through three narrow filters, 25 to 250 ms each: bllanos/chromatic-aberration, `demo_data` (Boost
licence), raw mosaics of 8 bits with a black level of 0. What short exposures say of each pixel predicts the longer
ones; from some count on these fall short. Charts are measured below that count (`calibration.color.exposures`).
"""

CHART = """\
In the RGB image that comes with them the chart is found without help: of {inside} of 24 patches all that is measured
lies on the patch of that number, by the published labels. The middles are {median:.1f} px from those of the labels in
the median, {worst:.1f} px at most, of patches {patch:.0f} px wide.
"""

BALLS = """\
Two mirror balls under twelve LEDs: yxiong/PSBox (MIT licence), JPEGs of clipped highlights with streaks, and circles
that were clicked by hand. Published are directions by the first ball, read off the same photographs in another way,
and no survey: agreement says that highlights are placed alike, not that either is right. The two balls stand apart, so
that near LEDs are seen in other directions.
"""


def page(data: Path, tolerance: float) -> tuple[str, dict[int, Linearity]]:
    """The page as Markdown, and the response behind each filter."""
    charts, balls = data / "chart_photographs", data / "mirrorball_psbox"
    found = {band: series_linearity(read_series(charts, band), tolerance) for band in FILTERS_NM}
    sensor = [
        f"| {band} nm | {limits.up_to:.0f} of 255 | {limits.black_level:+.1f} | "
        f"{100 * np.abs(limits.departure[limits.predicted < limits.full / 2]).max():.1f} % | "
        f"{100 * limits.departure[np.searchsorted(limits.predicted, 300)]:.0f} % |"
        for band, limits in found.items()
    ]
    chart = find_labelled_chart(charts)
    first, second = (probe_directions(balls / f"LightProbe-{number}") for number in (1, 2))
    compared = {
        "first ball, published": angles_deg(first, published_directions()),
        "first ball, second": angles_deg(first, second),
    }
    directions = [f"| {name} | {a.mean():.2f}° | {a.max():.2f}° |" for name, a in compared.items()]
    told = "\n".join([
        "# Photographed charts and mirror balls\n",
        "<!-- Written by `python -m benchmarks.bench_photographed_targets`: change it there. -->\n",
        paragraphs(HEAD),
        "## A sensor and its chart\n",
        paragraphs(SENSOR),
        f"| filter | linear to {100 * tolerance:g} % up to | black level found | off below half of full scale | off at "
        "300 predicted |\n|---|---|---|---|---|\n" + "\n".join(sensor) + "\n",
        "![Departure from a line by predicted count](pictures/sensor_linearity.png)\n",
        paragraphs(CHART.format(
            inside=chart.inside, median=np.median(chart.middle_px), worst=chart.middle_px.max(), patch=chart.patch_px
        )),
        "## Two mirror balls\n",
        paragraphs(BALLS),
        "| directions by | mean angle | largest |\n|---|---|---|\n" + "\n".join(directions),
    ])  # fmt: skip
    return told + "\n", found


def draw(found: dict[int, Linearity], tolerance: float, path: Path) -> None:
    """Draw the departure from a line by what shorter exposures predict, behind each filter."""
    legend = [Line2D([], [], color=color, label=f"{band} nm") for band, color in COLORS.items()]
    notes = ["Count over what shorter exposures predict, less 1, in per cent, by the count that is predicted.",
             "Grey: what counts as linear, and full scale."]  # fmt: skip
    with picture(path, (7.4, 2.8), "Where a sensor stops being linear", notes, legend) as figure:
        axes = figure.add_axes((0.08, 0.14, 0.88, 0.54))
        axes.axhspan(-100 * tolerance, 100 * tolerance, color=FAINT, lw=0)
        axes.axvline(255, color=FAINT, lw=3)
        for band, limits in found.items():
            axes.plot(limits.predicted, 100 * limits.departure, color=COLORS[band])
        axes.set(xlabel="predicted count", xlim=(0, 380), ylim=(-30, 5))
        axes.tick_params(colors=INK)


def main() -> None:
    """Measure, and write page and picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    tolerance = CalibrateColor().largest_nonlinearity
    told, found = page(parser.parse_args().data, tolerance)
    draw(found, tolerance, PICTURE)
    PAGE.write_text(told)


if __name__ == "__main__":
    main()
