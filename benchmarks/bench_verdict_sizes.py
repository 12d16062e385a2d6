"""Share of faults that each verdict misses, by how large they are, and the size of which half are seen.

    python -m benchmarks.bench_verdict_sizes [--faults "light moved"] [--captures 12] [--out results/verdicts]
        [--page docs/reliability.md]

The captures are those of `bench_verdicts`, the faults smaller. The size that is seen half of the time is interpolated
between neighbouring sizes, in logarithms. Rows of faults that are measured anew are replaced in sizes.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks import verdict_eyes, verdict_figures, verdict_images, verdict_lights, verdict_logs, verdict_rigs
from benchmarks.bench_verdicts import as_markdown
from docs.generate.markdown import put_between

FIRST_SEED = 1000
"""Captures that no bound was looked at with."""


@dataclass(frozen=True)
class SizedFault:
    """A fault of several sizes.

    Attributes:
        verdict: that should see it.
        fault: as the alarm knows it.
        unit: of the sizes.
        sizes: increasing in how wrong they are.
        alarm: from fault, seed and size to whether it is seen.
        scale: what the alarm takes, over the size.
        base: what sizes are distances from: 0 or, of factors, 1.
    """

    verdict: str
    fault: str
    unit: str
    sizes: tuple[float, ...]
    alarm: Callable[[str | None, int, float], bool]
    scale: float = 1.0
    base: float = 0.0


SIZED = {
    "camera knocked": SizedFault(
        "camera", verdict_rigs.KNOCKED, "mm and 0.1 degrees", (0.05, 0.1, 0.2, 0.5, 1),
        verdict_rigs.camera_alarm, 1e-3),
    "ball's radius wrong": SizedFault(
        "ball", verdict_lights.UNIT, "%", (0.5, 1, 2, 4, 8), verdict_lights.ball_alarm, 1e-2),
    "light moved": SizedFault(
        "light", verdict_lights.MOVED, "cm", (5, 10, 15, 20, 25, 30), verdict_lights.light_alarm, 1e-2),
    "red lamp on one chart": SizedFault(
        "color", verdict_logs.TINT, "x", (1.02, 1.05, 1.1, 1.2, 1.4, 1.8), verdict_logs.color_alarm, base=1),
    "exponent forgotten, on charts": SizedFault(
        "color", verdict_logs.CURVE, "exponent", (1.02, 1.05, 1.1, 1.2, 1.4), verdict_logs.color_alarm, base=1),
    "pattern of one frame exchanged": SizedFault(
        "log", verdict_logs.SWAP, "of all light", (0.03, 0.06, 0.1, 0.2, 0.5), verdict_logs.log_alarm),
    "tracked frame slipped": SizedFault(
        "tracked frame", verdict_figures.SLIPPED, "mm", (2, 5, 10, 15, 20, 40), verdict_figures.frame_alarm, 1e-3),
    "camera knocked after calibration": SizedFault(
        "tracked camera", verdict_figures.KNOCKED, "mm", (3, 5, 10, 15, 20, 30),
        verdict_figures.tracked_camera_alarm, 1e-3),
    "survey larger": SizedFault(
        "survey, by balls", verdict_eyes.LARGER, "%", (0.1, 0.2, 0.5, 1, 2), verdict_eyes.survey_alarm, 1e-2),
    "survey turned": SizedFault(
        "survey, by balls", verdict_eyes.TURNED, "degrees", (0.1, 0.2, 0.5, 1, 2), verdict_eyes.survey_alarm),
    "survey shifted": SizedFault(
        "survey, by balls", verdict_eyes.SHIFTED, "cm", (0.5, 1, 1.5, 2, 5), verdict_eyes.survey_alarm, 1e-2),
    "known lights turned": SizedFault(
        "survey, by brightness", verdict_images.TURNED, "degrees", (5, 10, 15, 20, 30), verdict_images.survey_alarm),
    "known lights shifted": SizedFault(
        "survey, by brightness", verdict_images.SHIFTED, "m", (0.2, 0.4, 0.6, 0.8, 1.0), verdict_images.survey_alarm),
    "exponent forgotten": SizedFault(
        "transfer", verdict_images.FORGOTTEN, "exponent", (1.1, 1.2, 1.4, 1.6, 1.8, 2.2),
        verdict_images.transfer_alarm, base=1),
    "one frame brighter": SizedFault(
        "exposure, changes", verdict_images.FRAME, "x", (1.02, 1.1, 1.2, 1.4, 1.7, 2.0),
        verdict_images.gain_alarm, base=1),
    "one image brighter": SizedFault(
        "exposure, changes", verdict_images.IMAGE, "x", (1.02, 1.2, 1.4, 1.7, 2.0, 3.0),
        verdict_images.gain_alarm, base=1),
    "one camera brighter from a frame on": SizedFault(
        "exposure, changes", verdict_images.CAMERA, "x", (1.02, 1.1, 1.2, 1.4, 1.7),
        verdict_images.gain_alarm, base=1),
    "all brighter from a frame on": SizedFault(
        "exposure, changes", verdict_images.ALL, "x", (1.02, 1.1, 1.15, 1.2, 1.4), verdict_images.gain_alarm, base=1),
    "overexposed": SizedFault(
        "exposure, levels", verdict_images.OVER, "x white", (1.2, 1.5, 2.0, 3.0, 4.0),
        verdict_images.level_alarm, base=1),
    "gaze off in three frames": SizedFault(
        "gaze", verdict_eyes.SOME, "degrees", (2, 4, 6, 8, 12), verdict_eyes.gaze_alarm),
}  # fmt: skip
"""Fault -> its sizes, and what makes and judges it."""


def missed_shares(sized: SizedFault, captures: int) -> list[float]:
    """Share of captures with the fault that are called good, by size; smaller sizes than one that is never seen are 1.

    Beginning with the largest: once nothing is seen, nothing smaller is asked for.
    """
    found: list[float] = []
    for size in reversed(sized.sizes):
        if found and found[-1] == 1.0:
            found.append(1.0)
            continue
        seen = [sized.alarm(sized.fault, FIRST_SEED + capture, sized.scale * size) for capture in range(captures)]
        found.append(1 - float(np.mean(seen)))
    return found[::-1]


def half_seen(sized: SizedFault, missed: list[float]) -> str:
    """The size of which half are missed."""
    wrong = np.log(np.array(sized.sizes) - sized.base)
    if missed[0] <= 0.5:
        return f"below {sized.sizes[0]:g}"
    if missed[-1] > 0.5:
        return f"above {sized.sizes[-1]:g}"
    after = next(k for k, share in enumerate(missed) if share <= 0.5)
    share = (missed[after - 1] - 0.5) / (missed[after - 1] - missed[after])
    return f"{sized.base + np.exp(wrong[after - 1] + share * (wrong[after] - wrong[after - 1])):.3g}"


def measure(name: str, captures: int) -> dict[str, object]:
    """One row of the table."""
    sized = SIZED[name]
    missed = missed_shares(sized, captures)
    told = "; ".join(f"{size:g}: {share:.0%}" for size, share in zip(sized.sizes, missed, strict=True))
    return {
        "fault": name, "verdict": sized.verdict, "unit": sized.unit, "missed, by size": told,
        "half are seen at": half_seen(sized, missed), "captures of each size": captures,
    }  # fmt: skip


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", nargs="*", choices=SIZED, default=list(SIZED), help="faults to measure")
    parser.add_argument("--captures", type=int, default=12, help="of each size")
    parser.add_argument("--out", type=Path, default=Path("results/verdicts"), help="folder for the table")
    parser.add_argument("--page", type=Path, help="page of docs that the table is put into")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    table = asked.out / "sizes.csv"
    found = {row["fault"]: row for row in pd.read_csv(table).to_dict("records")} if table.exists() else {}
    for name in asked.faults:
        found[name] = measure(name, asked.captures)
        print(*found[name].values(), sep=" | ", flush=True)
        pd.DataFrame([found[each] for each in SIZED if each in found]).to_csv(table, index=False)
    if asked.page:
        put_between(asked.page, "verdict sizes", as_markdown([found[each] for each in SIZED if each in found]))


if __name__ == "__main__":
    main()
