"""Text of the page that bench_adjusters writes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.bench_adjusters import Row
    from benchmarks.mesh_readers import Reading

EQUAL = 1.05
"""Ratio of two errors up to which they are one: rigs as these differ by more from one noise to the next."""

HEAD = """\
# Bundle adjustment: ours or pycolmap's

<!-- Written by `python -m benchmarks.bench_adjusters`: change it there. -->

A rig of cameras is calibrated from boards that stand anywhere, so that one least-squares problem holds all lenses, all
cameras and all boards. COLMAP solves such problems, too: board corners as fixed points, each view a frame, the cameras
a rig. Here both adjust the same corners from the same start. Ours has five coefficients of distortion, COLMAP's model
OPENCV four; the planted lenses have no fifth. *Bars* is the root mean square of the focal lengths' errors over their
error bars, 1 if these are honest; none where pycolmap refuses: its covariance (4.2.1) is for images of a rig's
reference camera alone (`covariance.cc: Check failed: image.IsRefInFrame()`). Seconds are of the adjustment with its
error bars, where there are any, on one core of the machine that wrote this page.

"""

DECISION = """\

Lines of code, without comments and docstrings, that only the adjustment needs: {ours} of ours, {pycolmap} that hand
the problem to pycolmap and take the cameras and the focal lengths' error bars back. The solver below ours
(`least_squares.py`) serves light, colour and eye calibration, and would stay.

## Decision

{verdict}

Beyond the table, these parts of calibration have no counterpart in pycolmap's adjustment, and would need a
problem of our own beside it:

- each image's own time, and the board's speed, for cameras that are not quite simultaneous
  ([photographed rigs](photographed_rigs.md));
- priors on lenses (`intrinsics: refine`), and the odds of each number of distortion coefficients, which decide how many
  a lens gets;
- the noise of corners, estimated within the fit: pycolmap's robust loss wants its scale beforehand, and was told it
  here, 2.4 times the true noise;
- error bars of the rig's shape, after the best rigid motion, instead of bars relative to one camera.

pycolmap reads and writes COLMAP's models here (`format: colmap`, `exports/colmap`).

## Meshes: ours or trimesh's

"""

MESHES = """\

trimesh reads .ply, writes the template without a skin and makes spheres; that stays. Told to change nothing, it reads
most .obj files as ours does, as fast, but not all: vertices of files with several materials come twice, and where a
seam runs through a texture, vertices that no face has are dropped. Keypoints, eyes and meshes of other frames name
vertices by number, so the {obj} lines that read .obj stay. Nor does it replace the reader of glTF: it drops skins,
joints and weights, which rigged templates need, so that a second reader for those without would be added to the first,
at the same speed.
"""


def page(rows: Sequence[Row], lines: Mapping[str, int], readings: Sequence[Reading]) -> str:
    """The whole page."""
    header = "| corners | cameras | method | centre, mm | focal length, % | bars | seconds |"
    table = [header, "|---|---|---|---|---|---|---|"]
    for row in rows:
        table.append(
            f"| {row.data} ({row.corners}) | {row.cameras} | {row.method} | {row.center_mm:.3f} | "
            f"{row.focal_percent:.4f} | {'none' if math.isnan(row.bars) else f'{row.bars:.2f}'} | {row.seconds:.2f} |"
        )
    meshes = ["| file | reader | vertices of the file | read | same order | ms |", "|---|---|---|---|---|---|"]
    for each in readings:
        same = "yes" if each.in_order else "no"
        meshes.append(
            f"| {each.kind} | {each.reader} | {each.vertices} | {each.found} | {same} | {each.milliseconds:.1f} |"
        )
    decision = DECISION.format(verdict=textwrap.fill(verdict(rows), 119), **lines)
    return HEAD + "\n".join(table) + "\n" + decision + "\n".join(meshes) + "\n" + MESHES.format(obj=lines["obj"])


def verdict(rows: Sequence[Row]) -> str:
    """Ours against the better of pycolmap's two losses, rig by rig, as a sentence that follows from the table."""
    groups: dict[tuple[str, int], dict[str, Row]] = {}
    for row in rows:
        groups.setdefault((row.data, row.cameras), {})[row.method] = row
    closer = faster = honest = 0
    for methods in groups.values():
        mine, theirs = methods["ours"], [row for name, row in methods.items() if name != "ours"]
        closer += mine.center_mm <= EQUAL * min(row.center_mm for row in theirs)
        faster += mine.seconds <= min(row.seconds for row in theirs)
        bars = [abs(row.bars - 1) for row in theirs if not math.isnan(row.bars)]
        honest += not bars or abs(mine.bars - 1) <= min(bars)
    stays = closer + faster + honest > 1.5 * len(groups)
    counted = (
        f"of {len(groups)} rigs, its centres are as close (to 5 %) or closer on {closer}, its error bars as honest or "
        f"more so (or the only ones) on {honest}, and it is as fast or faster on {faster}, each time against the "
        "better of pycolmap's two"
    )
    if stays:
        return f"Ours stays: {counted}."
    return f"By this table pycolmap should do it: {counted}."
