from __future__ import annotations

import doctest

import pytest

import pipeline.base.errors
from pipeline.base.errors import Complaints, InputError, listed


def test_no_complaint_raises_nothing() -> None:
    complaints = Complaints("capture")
    complaints.raise_if_any()
    assert not complaints


def test_every_complaint_is_named_with_its_subject_and_count() -> None:
    complaints = Complaints("captures/demo")
    complaints.add("a.csv", "x", expected="1", found="2")
    complaints.add("b.csv", "y", expected="3", found="4", hint="write 3")
    with pytest.raises(InputError) as caught:
        complaints.raise_if_any()
    assert str(caught.value).splitlines() == [
        "captures/demo: 2 problems",
        "  a.csv: x: expected 1, found 2",
        "  b.csv: y: expected 3, found 4; write 3",
    ]


def test_complaints_without_number_are_counted_and_not_all_said() -> None:
    complaints = Complaints("settings")
    complaints.messages += [f"line {number}" for number in range(20_000)]
    with pytest.raises(InputError) as caught:
        complaints.raise_if_any()
    first, *lines, last = str(caught.value).splitlines()
    assert (first, last) == ("settings: 20000 problems", "  ... and 19900 more")
    assert lines == [f"  line {number}" for number in range(100)]


def test_collecting_keeps_input_errors_and_lets_defects_through() -> None:
    complaints = Complaints("capture")
    with complaints.collecting():
        raise InputError("a.csv: expected a table, found none")
    assert complaints.messages == ["a.csv: expected a table, found none"]
    with pytest.raises(ZeroDivisionError), complaints.collecting():
        _ = 1 / 0


def test_listed_names_the_first_and_counts_all() -> None:
    assert listed([1, 2, 3], limit=3) == "1, 2, 3"
    assert listed(range(4), limit=3) == "0, 1, 2 ... (4 in all)"
    assert listed([]) == ""


def test_docstring_example_is_true() -> None:
    assert doctest.testmod(pipeline.base.errors).failed == 0
