"""False alarms and misses of every verdict, on sound and broken captures whose truth is known.

    python -m benchmarks.bench_verdicts [--verdicts camera log] [--captures 50] [--out results/verdicts]
        [--page docs/reliability.md]

What each function judges is made directly, so that a capture takes no more than a second. A false alarm: something of a
sound capture is weak or failed. A miss: of a broken one, what is broken is good. Faults take turns. The table of
verdicts is written as verdicts.csv, in which rows of verdicts that are measured anew are replaced, with a page of it
beside. Of a page of docs, these rows are replaced, too; the others stay.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Collection
from pathlib import Path

import pandas as pd

from benchmarks.verdict import Judged
from benchmarks.verdict_eyes import GAZE
from benchmarks.verdict_eyes import SURVEY as BALL_SURVEY
from benchmarks.verdict_figures import IMAGES, KEYPOINTS, MASKS, TRACKED_CAMERA, TRACKED_FRAME
from benchmarks.verdict_images import GAIN, LEVEL, SURVEY, TRANSFER
from benchmarks.verdict_lights import BALL, LIGHT
from benchmarks.verdict_logs import COLOR, LOG
from benchmarks.verdict_rigs import CAMERA
from docs.generate.markdown import parted, put_between

JUDGED: dict[str, Judged] = {
    "images": IMAGES, "camera": CAMERA, "ball": BALL, "light": LIGHT, "color": COLOR, "log": LOG,
    "tracked keypoints": KEYPOINTS, "tracked masks": MASKS, "tracked frame": TRACKED_FRAME,
    "tracked camera": TRACKED_CAMERA, "survey, by balls": BALL_SURVEY, "survey, by brightness": SURVEY,
    "transfer": TRANSFER, "exposure, levels": LEVEL, "exposure, changes": GAIN, "gaze": GAZE,
}  # fmt: skip
"""Verdict -> what makes captures and asks for it."""


def measure(name: str, captures: int) -> dict[str, object]:
    """One row of the table: counts over as many sound captures as broken ones."""
    judged, started = JUDGED[name], time.perf_counter()
    alarms = sum(judged.alarm(None, seed) for seed in range(captures))
    faults = [judged.faults[k % len(judged.faults)] for k in range(captures)]
    missed = Counter(fault for k, fault in enumerate(faults) if not judged.alarm(fault, captures + k))
    asked = Counter(faults)
    told = "; ".join(f"{fault} {missed[fault]} of {asked[fault]}" for fault in judged.faults)
    return {
        "verdict": name, "judged by": f"`{judged.by}`", "sound": captures, "false alarms": alarms, "broken": captures,
        "missed": missed.total(), "missed, by fault": told, "seconds": round(time.perf_counter() - started, 1),
    }  # fmt: skip


def as_markdown(rows: list[dict[str, object]]) -> str:
    """The table without its times."""
    columns = [name for name in rows[0] if name != "seconds"]
    lines = [columns, ["---"] * len(columns), *([str(row[name]) for name in columns] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def merged(before: str, rows: list[dict[str, object]], measured: Collection[str]) -> str:
    """A page's table with rows that were measured now, in the order of `JUDGED`; what else it has stays."""
    new = as_markdown([row for row in rows if row["verdict"] in measured]).splitlines()
    kept = {line.split(" | ")[0].removeprefix("| "): line for line in [*before.splitlines()[2:], *new[2:]]}
    return "\n".join([*new[:2], *(kept[name] for name in JUDGED if name in kept)]) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--verdicts", nargs="*", choices=JUDGED, default=list(JUDGED), help="verdicts to measure")
    parser.add_argument("--captures", type=int, default=50, help="sound ones, and broken ones, of each")
    parser.add_argument("--out", type=Path, default=Path("results/verdicts"), help="folder for the tables")
    parser.add_argument("--page", type=Path, help="page of docs that the table is put into")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    table = asked.out / "verdicts.csv"
    found = {row["verdict"]: row for row in pd.read_csv(table).to_dict("records")} if table.exists() else {}
    for name in asked.verdicts:
        found[name] = measure(name, asked.captures)
        print(*found[name].values(), sep=" | ", flush=True)
        rows = [found[each] for each in JUDGED if each in found]
        pd.DataFrame(rows).to_csv(table, index=False)
    (asked.out / "table.md").write_text(as_markdown(rows))
    if asked.page:
        put_between(asked.page, "verdicts", merged(parted(asked.page, "verdicts")[1], rows, asked.verdicts))


if __name__ == "__main__":
    main()
