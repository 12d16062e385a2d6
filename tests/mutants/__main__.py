"""Plant bugs, one at a time, in a copy of the project, and see whether its tests notice.

    python -m tests.mutants [--layers geometry sync] [--out results/mutants] [--only TEXT] [--minutes M]
        [--page docs/reliability.md]

The bugs stand in tests/mutants/listed, one file per layer. Judgements are added to mutants.csv as they come; a run that
was ended goes on, and judges anew what has changed since, or whose tests have. Exits with 1 if a bug is not seen that
has no reason not to be, if one is seen that has, if one could not be judged, or if less than 95 % are seen.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tests.support.mutants import records, trial
from tests.support.mutants.judging import ALLOWED_S, Court
from tests.support.mutants.mutant import Mutant, read_mutants
from tests.support.mutants.records import SEEN, Judgement, Verdict
from tests.support.mutants.tree import Tree
from tests.support.workflow.stage_server import LIBRARIES

ROOT = Path(__file__).resolve().parents[2]
LISTED = Path(__file__).with_name("listed")

ASKED_SHARE = 0.95
"""Of mutants that tests have to see."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--layers", nargs="*", help="lists to go through; all, if not given")
    parser.add_argument("--root", type=Path, default=ROOT, help="the project")
    parser.add_argument("--listed", type=Path, default=LISTED, help="folder of the lists")
    parser.add_argument("--out", type=Path, default=Path("results/mutants"), help="folder for the table and the copy")
    parser.add_argument("--only", default="", help="mutants whose file or meaning has these letters")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="after which no further mutant is judged")
    parser.add_argument("--kept", action="store_true", help="judge none: show what earlier runs have judged")
    parser.add_argument("--page", type=Path, help="page of docs that the table is put into")
    parser.add_argument("--patience", type=float, default=ALLOWED_S, help="seconds beyond what tests usually take")
    parser.add_argument("--few-imports", action="store_true", help="the project's tests need no libraries but pytest")
    asked = parser.parse_args()
    mutants = read_mutants(asked.listed)
    for mutant in mutants:
        mutant.require_change(asked.root)
    if unknown := set(asked.layers or []) - {mutant.layer for mutant in mutants}:
        parser.error(f"--layers: no list of {', '.join(sorted(unknown))} in {asked.listed}")
    chosen = [m for m in mutants if m.layer in (asked.layers or [m.layer]) and asked.only in f"{m.file}: {m.meaning}"]
    root, out = asked.root.resolve(), asked.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    trial.prepare(
        () if asked.few_imports or asked.kept else (*LIBRARIES, "hypothesis", "beartype", "jaxtyping", "matplotlib")
    )
    court = Court(Tree.made(root, out / "tree"), out, asked.patience)
    found = court.kept(chosen) if asked.kept else judge(court, chosen, asked.minutes)
    shutil.rmtree(out / "scratch", ignore_errors=True)
    table = records.counted(chosen, found)
    (out / "table.md").write_text(table)
    print(table)
    if asked.page:
        records.write_page(asked.page, table)
    sys.exit(bool(complaints(found, len(chosen))))


def judge(court: Court, chosen: Sequence[Mutant], minutes: float) -> list[tuple[Mutant, Judgement]]:
    """Judge mutants, say what comes of each, and stop after a while."""
    found: list[tuple[Mutant, Judgement]] = []
    began = time.monotonic()
    for mutant, judgement in zip(chosen, court.judged(chosen), strict=False):
        found.append((mutant, judgement))
        mark = " " if judgement.verdict in SEEN else "!"
        words = f"{judgement.verdict}, {judgement.seconds:.1f} s: {judgement.mutant} {judgement.by}"
        print(f"{mark} {mutant.layer}: {words}", flush=True)
        if time.monotonic() - began > 60 * minutes:
            break
    return found


def complaints(found: list[tuple[Mutant, Judgement]], chosen: int) -> list[str]:
    """Print, and return, what is not as it should be."""
    wrong = []
    for mutant, judgement in found:
        if judgement.verdict is Verdict.UNJUDGED:
            wrong.append(f"{mutant}: {mutant.meaning}: its tests did not run")
        if judgement.verdict is Verdict.SURVIVED and not mutant.survives:
            wrong.append(f"{mutant}: {mutant.meaning}: no test sees it; write one, or argue in its list why none can")
        if judgement.verdict in SEEN and mutant.survives:
            wrong.append(f"{mutant}: {mutant.meaning}: a test sees it now; delete `survives` from its list")
    seen = sum(judgement.verdict in SEEN for _, judgement in found)
    if seen < ASKED_SHARE * len(found):
        wrong.append(f"{seen} of {len(found)} seen, asked for {ASKED_SHARE:.0%}")
    if len(found) < chosen:
        print(f"{len(found)} of {chosen} judged; the same command goes on")
    print("\n".join(wrong) or "nothing to mend")
    return wrong


if __name__ == "__main__":
    main()
