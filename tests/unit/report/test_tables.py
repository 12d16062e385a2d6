"""Numbers read as a person writes them; text is escaped, HTML is not."""

from __future__ import annotations

import math

import pytest

from pipeline.report.tables import Html, html_table, number, p_text, significant


def test_numbers():
    assert [number(1.005, 1), number(-0.5), number(2.0, 3, "+"), number(math.nan)] == ["1.0", "−0.50", "+2.000", "–"]
    assert [significant(0.00001234), significant(1234.5), significant(math.inf)] == ["1.23e−05", "1.23e+03", "–"]
    assert [p_text(1e-9), p_text(0.04961), p_text(math.nan)] == ["< 0.001", "0.0496", "–"]


def test_cells_are_escaped_unless_they_are_html():
    table = html_table('the "table"', ["<a>", "b"], [["<i>", Html("<b>x</b>")], ["a & group"]], "n")
    assert "&lt;a&gt;" in table and "&lt;i&gt;" in table and "<td><b>x</b></td>" in table
    assert '<td class="number">' in table and '<th colspan="2">a &amp; group</th>' in table
    assert 'aria-label="the &quot;table&quot;"' in table


def test_rows_of_another_length_are_an_error():
    with pytest.raises(ValueError, match="zip"):
        html_table("t", ["a", "b", "c"], [[1, 2]])
