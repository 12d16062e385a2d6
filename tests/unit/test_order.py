"""Files of tests that are handed out first."""

from __future__ import annotations

from types import SimpleNamespace

from tests.support.order import LONGEST_FIRST, TESTS, longest_first


def test_files_that_come_first_are_there():
    assert [name for name in LONGEST_FIRST if not (TESTS / name).is_file()] == []
    assert len(set(LONGEST_FIRST)) == len(LONGEST_FIRST)


def test_long_files_come_first_and_all_else_stays_as_it_was():
    names = ["unit/test_docs.py", LONGEST_FIRST[1], "unit/test_docs.py", "hard_cases/test_eyes.py", *LONGEST_FIRST[:2]]
    items = [SimpleNamespace(path=TESTS / name, number=number) for number, name in enumerate(names)]
    assert [item.number for item in longest_first(items)] == [4, 1, 5, 0, 2, 3]
