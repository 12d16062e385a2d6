"""Rows of a page's table of verdicts, of which some are measured anew."""

from __future__ import annotations

from benchmarks.bench_verdicts import JUDGED, as_markdown, merged


def row(name: str, alarms: int) -> dict[str, object]:
    """A row as it is measured, shortened."""
    return {"verdict": name, "judged by": "`x`", "false alarms": alarms, "seconds": 1.0}


def test_rows_that_were_not_measured_stay_and_all_keep_their_order():
    first, second, third = list(JUDGED)[:3]
    before = as_markdown([row(first, 1), row(second, 2)])
    # The table of results may hold rows of earlier runs, which a page shows only once they are asked for.
    found = merged(before, [row(first, 7), row(third, 3), row(second, 8)], [second, third])
    assert found == as_markdown([row(first, 1), row(second, 8), row(third, 3)])
