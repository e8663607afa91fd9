"""Tables of text for terminals."""

from __future__ import annotations

import pytest

from ua_fleet.cli.table import Cell, Colour, painted, table_lines, width_of, within


def test_columns_are_in_line() -> None:
    assert table_lines([("node", "value"), ("a", "1"), ("long name", "22")]) == [
        "node       value",
        "a          1",
        "long name  22",
    ]
    assert table_lines([]) == []
    assert table_lines([("a", "", ""), ("bb", "", "c")], indent="  ") == ["  a", "  bb    c"]


def test_wide_characters_take_two_cells() -> None:
    assert [width_of(text) for text in ("ab", "ü", "机器人", "e\u0301", "")] == [2, 1, 6, 1, 0]
    assert table_lines([("机器", "1"), ("abc", "2")]) == ["机器  1", "abc   2"]
    assert within("机器人", 5) == "机器…"


def test_no_line_is_wider_than_the_terminal() -> None:
    rows = [("n" * 60, "v" * 30, "Good"), ("m", "w", "BadNoCommunication")]
    lines = table_lines(rows, width=60)
    assert [width_of(line) for line in lines] <= [60, 60]
    assert max(map(len, lines)) <= 60
    assert lines[1].endswith("BadNoCommunication")
    assert "…" in lines[0]
    assert table_lines(rows, width=200) == table_lines(rows)


def test_a_terminal_that_is_too_narrow_for_any_table_ends_the_cutting() -> None:
    assert table_lines([("n" * 60, "v" * 30)], width=5) == ["nnnnnnn…  vvvvvvv…"]


def test_the_end_of_a_name_can_be_kept() -> None:
    assert within("ridgeback/Skills/fetch", 10) == "ridgeback…"
    assert within("ridgeback/Skills/fetch", 10, keeps_end=True) == "…lls/fetch"
    (line,) = table_lines([(Cell("ridgeback/Skills/fetch", keeps_end=True),)], width=10)
    assert line == "…lls/fetch"


def test_colours_are_there_only_where_they_are_wanted() -> None:
    row = [(Cell("BadNoCommunication", Colour.BAD), "x")]
    assert table_lines(row) == ["BadNoCommunication  x"]
    assert table_lines(row, colours=True) == ["\x1b[31mBadNoCommunication\x1b[0m  x"]
    assert painted("", Colour.BAD, colours=True) == ""


@pytest.mark.parametrize("colours", [True, False])
def test_what_a_terminal_would_obey_is_made_harmless(colours: bool) -> None:
    assert painted("a\x1b[2Jb\n", None, colours=colours) == "a\\x1b[2Jb\\n"
    assert table_lines([("a\x1b[2Jb", "x")], colours=colours) == ["a\\x1b[2Jb  x"]
