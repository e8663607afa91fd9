"""The same result as table, JSON, CSV and figures."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import pytest
from ua_demo.equations import EQUATION_12_KINDS, equation_12_sum
from ua_demo.simulators.fleet import Result, Settings, figures, report, simulate

from ua_fleet.traffic import MessageKind


@pytest.fixture(scope="module")
def result() -> Result:
    return simulate(Settings(4, 6, faults=1))


def test_json_has_the_form_that_was_promised(result: Result) -> None:
    shown = json.loads(json.dumps(report.as_json(result)))
    assert (shown["robots"], shown["tasks"], shown["tasks_done"], shown["outcome"]) == (4, 6, 6, "done")
    for name in ("messages", "bytes"):
        assert shown[name].keys() == {"total_equation_12_kinds", *MessageKind}
        assert shown[name]["total_equation_12_kinds"] == sum(shown[name][kind] for kind in EQUATION_12_KINDS) > 0
        assert all(
            shown[name][kind] == sum(row[name] for row in shown["over_time"] if row["kind"] == kind)
            for kind in MessageKind
        )
    assert shown["equation_12"] == 4 * 11 / 2 + 2 * 1 + 5 * 6  # as the paper has it: n(n+7)/2 + 2 N_f + 5 N_d
    assert shown["wall_s"] > 0
    (fault,) = shown["faults"]
    assert fault["robot"] != fault["replacement"]


def test_the_equations_parts_are_their_sum(result: Result) -> None:
    shown = report.as_json(result)
    assert sum(shown["equations"].values()) == shown["equation_12"]


def test_csv_sums_up_to_the_totals(result: Result) -> None:
    rows = list(csv.DictReader(io.StringIO("\n".join(report.as_csv(result)))))
    for kind in MessageKind:
        of_kind = [row for row in rows if row["kind"] == kind]
        assert sum(int(row["messages"]) for row in of_kind) == result.traffic.messages[kind]
        assert sum(int(row["bytes"]) for row in of_kind) == result.traffic.bytes[kind]
    seconds = [int(row["second"]) for row in rows]
    assert seconds == sorted(seconds)
    assert seconds[-1] == int(result.ended_s)


def number(cell: str) -> int:
    return int(cell.strip().replace(",", ""))


def test_tables_sum_up_to_the_totals(result: Result) -> None:
    counted, others = equation_12_sum(result.traffic.messages), result.traffic.messages.total()
    table = {row[0]: row for row in report.kinds_table(result)}
    assert table.keys() == {"kind", "together", *MessageKind}
    assert number(table["together"][1]) == sum(number(table[kind][1]) for kind in EQUATION_12_KINDS) == counted
    assert number(table["together"][2]) == sum(number(table[kind][2]) for kind in EQUATION_12_KINDS)
    assert table["together"][3].startswith("54 (Eq. 12)")
    _, *rows = report.intervals(result)
    assert sum(number(row[1]) for row in rows) == counted
    assert sum(number(row[3]) for row in rows) == others - counted


@pytest.mark.parametrize(("most", "points"), [(1, [1]), (2, [1, 2]), (4, [1, 2, 3, 4]), (100, [1, 25, 50, 75, 100])])
def test_points_of_the_figures(most: int, points: list[int]) -> None:
    assert figures.grid_of(most) == points


def test_figures_are_drawn_and_are_the_same_each_time(result: Result, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    told: list[tuple[int, int]] = []
    points = figures.sweep(result, lambda done, of: told.append((done, of)))
    assert points.keys() == {(robots, tasks) for robots in (1, 2, 3, 4) for tasks in (1, 2, 3, 4, 6)}
    assert told == [(number, 20) for number in range(20)]
    assert all(point.is_right and not point.settings.faults for point in points.values())
    drawn: list[list[bytes]] = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        files = figures.draw(result, points, tmp_path / name)
        assert [file.name for file in files] == [f"{name}.{e}" for name in figures.FIGURES for e in ("png", "svg")]
        drawn.append([file.read_bytes() for file in files])
    assert drawn[0] == drawn[1]
    assert all(content.startswith(b"\x89PNG") for content in drawn[0][::2])
    assert all(re.search(rb"<svg[ >]", content) for content in drawn[0][1::2])


def test_the_simulation_itself_is_not_done_again_for_its_figures() -> None:
    result = simulate(Settings(1, 1))
    assert figures.sweep(result, lambda _done, _of: None) == {(1, 1): result}
