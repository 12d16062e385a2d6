"""Fit what public sets take in disk, memory and minutes to fakes of three sizes, and extrapolate it.

    python -m benchmarks.bench_dataset_costs [--only goliath ...]

Of each set three fakes, whose images have 1, 4 and 16 times as many pixels, go through all stages up to the packed
images, in one process, whose start is not counted, and in a process of their own each for their memory: what a process
once had hides what it needs. Training and scores are for steps and images that are chosen. Processor time and bytes
grow with all pixels, memory with those of one image, as chunks are read image by image; straight lines are fitted. The
interval of an extrapolation is the worst of the three points, times what an exponent that is off by `EXPONENT_ERROR`
makes of the distance. Writes the table between marks of docs/datasets.md.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml

from benchmarks.bench_datasets import size_mb
from benchmarks.fake_sets import FAKES, FakeSet
from benchmarks.marked_page import write_between
from benchmarks.paper_costs import EXPONENT_ERROR, Range, digits
from pipeline.base.files import read_table
from pipeline.config.import_capture import ImportCapture
from tests.support.datasets.imported import import_set, packed

PAGE = Path("docs/datasets.md")

FACTORS = (0.5, 1.0, 2.0)
"""Sides of the fakes' images over those of `fake_sets`."""

ATLAS = {"openillumination": 128}
"""Sides of atlases that have to hold more charts than those of a head: a visual hull's."""


@dataclass(frozen=True)
class RealSize:
    """Numbers of one capture of a set: cameras, frames, and pixels of an image."""

    cameras: int
    frames: int
    width: int
    height: int
    note: str = ""

    @property
    def image_mp(self) -> float:
        """Megapixels of an image."""
        return self.width * self.height / 1e6

    @property
    def all_mp(self) -> float:
        """Megapixels of all images."""
        return self.image_mp * self.cameras * self.frames


REAL = {
    "goliath": RealSize(172, 30_000, 1334, 2048),
    "goliath_hand": RealSize(172, 30_000, 1334, 2048, "frames assumed: those of a head"),
    "goliath_body": RealSize(220, 10_000, 1334, 2048),
    "becominglit": RealSize(16, 10_000, 550, 802, "reduced to a quarter; frames assumed: two minutes and a half"),
    "humanolat": RealSize(40, 345, 810, 1440),
    "openillumination": RealSize(22, 142, 2000, 1500, "OLAT; size of the images assumed"),
    "olatverse": RealSize(30, 345, 1500, 2844),
    "faceolat": RealSize(40, 350, 2160, 4096),
    "ava256": RealSize(80, 5_000, 1334, 2048, "frames assumed"),
    "actorshq": RealSize(148, 2_000, 1028, 752, "scale 4x; frames assumed"),
    "nersemble": RealSize(16, 1_100, 1100, 1604, "reduced to a half; one long sequence"),
}  # fmt: skip
"""One capture of each set, as DATASHEETs and loaders count it; what they do not say is assumed, and said so."""


@dataclass(frozen=True)
class Measured:
    """A fake of one size: megapixels of an image and of all, and what it took."""

    image_mp: float
    all_mp: float
    cpu_s: float
    peak_mb: float
    disk_mb: float


@dataclass(frozen=True)
class Line:
    """A straight line through the measured points, neither part negative, and its worst factor."""

    start: float
    slope: float
    worst: float
    farthest: float

    @classmethod
    def through(cls, x: Sequence[float], y: Sequence[float]) -> Line:
        """Least squares of relative errors."""
        x, y = np.array(x), np.array(y)
        slope, start = np.polyfit(x, y, 1, w=1 / y)
        if start < 0:
            start, slope = 0.0, float((x / y).sum() / ((x / y) ** 2).sum())
        if slope < 0:
            start, slope = float(1 / (1 / y).mean()), 0.0
        ratio = y / (start + slope * x)
        return cls(float(start), float(slope), float(np.maximum(ratio, 1 / ratio).max()), float(x.max()))

    def at(self, x: float) -> Range:
        """The value there, with its interval."""
        middle, off = self.start + self.slope * x, self.worst * max(1.0, x / self.farthest) ** EXPONENT_ERROR
        return Range(middle / off, middle, middle * off)


def run_fake(fake: FakeSet, factor: float) -> Measured:
    """Take a fake through the stages, in this process."""
    width, height = (2 * round(side * factor / 2) for side in fake.image)
    with tempfile.TemporaryDirectory() as made:
        folder, truth = Path(made), fake.truth(image=(width, height))
        shipped = fake.write(folder / "set", truth)
        chosen = ImportCapture(**yaml.safe_load(fake.settings(folder, truth)))
        started = time.process_time()
        capture, results = import_set(fake.dataset, shipped, folder, chosen)
        packed(capture, results, ATLAS.get(fake.name, 32))
        cpu_s, image_mp = time.process_time() - started, width * height / 1e6
        images = len(read_table(results / "index/images.parquet"))
        return Measured(image_mp, image_mp * images, cpu_s, peak_mb(), size_mb(capture) + size_mb(results))


def peak_mb() -> float:
    """Largest memory of this process, megabytes."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")]
    return int(line.split()[1]) / 1024


def peak_of(name: str, factor: float) -> float:
    """Largest memory of a process that takes a fake through the stages and does nothing else, megabytes."""
    (fake,) = [fake for fake in FAKES if fake.name == name]
    return run_fake(fake, factor).peak_mb


def measure(fake: FakeSet) -> list[Measured]:
    """All sizes of a fake; what is imported or compiled at first use is no part of their processor time."""
    run_fake(fake, FACTORS[0])
    found = [run_fake(fake, factor) for factor in FACTORS]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as alone:
        peaks = alone.map(partial(peak_of, fake.name), FACTORS)
        found = [replace(each, peak_mb=peak) for each, peak in zip(found, peaks, strict=True)]
    print(fake.name, *found, sep="\n", flush=True)
    return found


def row(fake: FakeSet, found: Sequence[Measured]) -> str:
    """A row of the table."""
    real = REAL[fake.name]
    cpu = Line.through([each.all_mp for each in found], [each.cpu_s for each in found]).at(real.all_mp)
    disk = Line.through([each.all_mp for each in found], [each.disk_mb for each in found]).at(real.all_mp)
    peak = Line.through([each.image_mp for each in found], [each.peak_mb for each in found]).at(real.image_mp)
    shown = " / ".join(f"{each.cpu_s:.1f} s, {each.peak_mb:.0f}, {each.disk_mb:.1f} MB" for each in found)
    size = f"{real.cameras} x {real.frames:,} x {real.width} x {real.height}{f' ({real.note})' if real.note else ''}"
    ranges = (words(disk, 1000.0), words(peak, 1000.0), words(cpu, 60.0))
    return f"| {fake.name} | {shown} | {size} | {' | '.join(ranges)} |"


def words(found: Range, unit: float) -> str:
    """`middle (low to high)` in a unit."""
    return f"{digits(found.middle / unit)} ({digits(found.low / unit)} to {digits(found.high / unit)})"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="*", default=[fake.name for fake in FAKES], help="sets; no page is written")
    options = parser.parse_args()
    fakes = {fake.name: fake for fake in FAKES}
    lines = [
        "| set | three fakes: processor, memory, disk | a capture: cameras x frames x pixels | disk written, GB | "
        "memory of a process, GB | minutes of a processor |",
        "|---|---|---|---|---|---|",
        *(row(fakes[name], measure(fakes[name])) for name in options.only),
    ]
    print("\n".join(lines))
    if options.only == list(fakes):
        write_between(PAGE, "costs", lines)


if __name__ == "__main__":
    main()
