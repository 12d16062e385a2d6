"""Seconds that tracking a chunk of a finished subject takes, by part, and how its results compare.

`python -m benchmarks.bench_tracking --results results/walker --capture captures/walker` tracks anew, in a folder of its
own, with the default settings, and compares vertices and residuals with the subject's. Seconds are those of a part
itself, without the parts that it calls, of the wall clock and of all threads' processors. Prints one line per part.

To compare two checkouts, run the same file in both: what one of them lacks counts as "all else". Unless said otherwise,
`--capture` is `captures/SUBJECT` beside `results`.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from unittest import mock

import numpy as np
from safetensors.numpy import load_file

from pipeline.base.files import read_table
from pipeline.stages import track_mesh

PARTS = {
    "read masks": ("pipeline.stages.track_mesh", "mask_views"),
    "read images": ("pipeline.stages.track_mesh", "read_color_views"),
    "blur images": ("pipeline.tracking.color_views", "ColorView.blurred"),
    "triangulate keypoints": ("pipeline.tracking.mesh_tracker", "triangulate_unswapped"),
    "draw silhouettes": ("pipeline.tracking.silhouette_cue", "SilhouetteCue.around"),
    "look up images": ("pipeline.tracking.image_cue", "ImageCue.around"),
    "set up equations": ("pipeline.tracking.pose_solver", "normal_equations"),
    "solve equations": ("pipeline.tracking.pose_solver", "solve_equations"),
    "offset vertices": ("pipeline.tracking.keyframe_refinement", "fit_offsets"),
    "write": ("pipeline.stages.track_mesh", "_write"),
}
"""Functions timed, by what they do. A `Cue`'s `around` returns a function of positions, timed as "residuals"."""

REST, RESIDUALS = "all else", "residuals of cues"


class Clock:
    """Seconds of parts that call each other: a part's time stops while another part runs."""

    def __init__(self) -> None:
        self.wall, self.cpu, self.calls = defaultdict(float), defaultdict(float), defaultdict(int)
        self.running, self.since = [REST], self._now()

    @staticmethod
    def _now() -> tuple[float, float]:
        return time.perf_counter(), time.process_time()

    def lap(self) -> None:
        """Add the time since the last lap to the innermost running part."""
        now = self._now()
        self.wall[self.running[-1]] += now[0] - self.since[0]
        self.cpu[self.running[-1]] += now[1] - self.since[1]
        self.since = now

    def timed(self, part: str, function: Callable) -> Callable:
        """The function, with its time counted for a part; if it returns a function, that one's, too."""

        @functools.wraps(function)
        def timed(*arguments, **words):
            self.lap()
            self.running.append(part)
            self.calls[part] += 1
            try:
                result = function(*arguments, **words)
            finally:
                self.lap()
                self.running.pop()
            return self.timed(RESIDUALS, result) if callable(result) else result

        return timed


def measure(results: Path, capture: Path, chunk: int, out: Path) -> Clock:
    """Track one chunk into the folder `out`, timing its parts."""
    clock = Clock()
    with ExitStack() as stack:
        for part, (module, name) in PARTS.items():
            *owners, attribute = name.split(".")
            owner = functools.reduce(getattr, owners, importlib.import_module(module))
            if not hasattr(owner, attribute):  # as in a checkout of before it had this name
                continue
            stack.enter_context(mock.patch.object(owner, attribute, clock.timed(part, getattr(owner, attribute))))
        clock.lap()
        track_mesh.run(
            capture=capture, index=results / "index", cameras=results / "calibration/cameras.json", chunk=chunk,
            out=out, patterns=results / "patterns.parquet", lights=results / "calibration/lights.parquet",
        )  # fmt: skip
        clock.lap()
    return clock


def compare(before: Path, after: Path, chunk: int) -> str:
    """How far vertices of two runs are apart, and their mean residuals."""
    old, new = (load_file(folder / f"{chunk:04d}.safetensors")["vertices"].astype(float) for folder in (before, after))
    apart = 1e3 * np.sqrt(((new - old) ** 2).sum(-1).mean())
    rows = [f"vertices {apart:.6f} mm rms from those of the results"]
    tables = [read_table(folder / f"{chunk:04d}.parquet") for folder in (before, after)]
    for name in ("rms_px", "silhouette_iou"):
        rows.append(f"{name} {tables[0][name].mean():.6f} -> {tables[1][name].mean():.6f}")
    return "\n".join(rows)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--capture", type=Path, help="captures/SUBJECT")
    parser.add_argument("--chunk", type=int, default=0)
    args = parser.parse_args()
    capture = args.capture or args.results.parents[1] / "captures" / args.results.name
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        clock = measure(args.results, capture, args.chunk, Path(folder))
        agreement = compare(args.results / "tracking", Path(folder), args.chunk)
    print(f"{'part':24}{'calls':>8}{'wall s':>10}{'cpu s':>10}")
    print(f"{'import':24}{1:8d}{'':10}{start:10.2f}")
    for part in sorted(clock.wall, key=lambda part: -clock.cpu[part]):
        print(f"{part:24}{clock.calls[part]:8d}{clock.wall[part]:10.2f}{clock.cpu[part]:10.2f}")
    print(f"{'sum':24}{'':8}{sum(clock.wall.values()):10.2f}{start + sum(clock.cpu.values()):10.2f}")
    print(f"memory at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    print(agreement)


if __name__ == "__main__":
    main()
