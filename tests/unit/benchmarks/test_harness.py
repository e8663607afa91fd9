"""The benchmarks' harness: what holds, and which rows a run replaces."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import __main__ as command
from benchmarks.harness import (
    PART,
    Failed,
    Figure,
    Unavailable,
    at_least,
    at_most,
    interleaved,
    merge_results,
    shown,
    wanted,
)


def test_at_least() -> None:
    figure = at_least("encode", 2.0, "us", reference="peer", reference_value=80.0, goal=30.0)
    assert figure == Figure("encode", 2.0, "us", "peer", 80.0, 40.0, 30.0, True)
    assert not at_least("encode", 4.0, "us", reference="peer", reference_value=80.0, goal=30.0).holds


def test_at_most() -> None:
    assert at_most("p50", 3.0, "ms", reference="floor", reference_value=2.0, goal=2.0).holds
    assert not at_most("p50", 5.0, "ms", reference="floor", reference_value=2.0, goal=2.0).holds
    missed = at_most("p99", 10.0, "ms", reference="floor", reference_value=2.0, goal=4.0, fails_beyond=8.0)
    assert (missed.ratio, missed.goal, missed.holds) == (5.0, 4.0, True)


def test_shown_always_holds() -> None:
    figure = shown("to the server", 3.0, "ms", reference="floor", reference_value=2.0)
    assert (figure.ratio, figure.goal, figure.holds) == (1.5, None, True)


def test_measures_take_turns_and_their_medians_count() -> None:
    turns: list[str] = []
    samples = {"a": iter([1.0, 9.0, 2.0, 3.0, 4.0]), "b": iter([5.0] * 5)}

    def measure(name: str) -> float:
        turns.append(name)
        return next(samples[name])

    assert interleaved(1, [lambda: measure("a"), lambda: measure("b")]) == [3.0, 5.0]
    assert turns == ["a", "b"] * 5


def test_a_run_replaces_the_rows_of_its_group(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    row = shown("x", 1.0, "s", reference="floor", reference_value=1.0)
    merge_results(path, "space", [row])
    merge_results(path, "codec", [row, row._replace(name="y")])
    merge_results(path, "codec", [row._replace(value=2.0)])
    rows = json.loads(path.read_text(encoding="utf-8"))
    assert [(entry["name"], entry["value"]) for entry in rows] == [("codec: x", 2.0), ("space: x", 1.0)]
    assert set(rows[0]) == {"name", "value", "unit", "reference", "reference_value", "ratio", "goal", "holds"}


@pytest.mark.parametrize("holds", [True, False])
def test_exit_code(holds: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = shown("x", 1.0, "s", reference="floor", reference_value=1.0)._replace(holds=holds)
    monkeypatch.setattr(command, "RESULTS", tmp_path / "results.json")

    def figures(_rounds: int) -> list[Figure]:
        return [figure]

    monkeypatch.setattr("benchmarks.codec.figures", figures)
    monkeypatch.setattr("sys.argv", ["benchmarks", "--only", "codec"])
    assert command.main() == (0 if holds else 1)


@pytest.mark.parametrize(("error", "code"), [(Unavailable("no rospy"), 0), (Failed("the bridge ended"), 1)])
def test_a_group_that_fails_is_not_one_that_cannot_run(
    error: Exception, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def figures(_rounds: int) -> list[Figure]:
        raise error

    monkeypatch.setattr("benchmarks.codec.figures", figures)
    monkeypatch.setattr("sys.argv", ["benchmarks", "--only", "codec"])
    assert command.main() == code
    assert str(error) in capsys.readouterr().err


def test_a_part_of_a_group_replaces_its_own_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "results.json"
    row = at_least("Read", 1.0, "us", reference="peer", reference_value=2.0, goal=1.2)
    merge_results(path, "services", [row, row._replace(name="Call")])
    assert wanted("Read")
    monkeypatch.setenv(PART, "Call")
    assert wanted("Call")
    assert not wanted("Read")
    merge_results(path, "services", [row._replace(name="Call", value=3.0)])
    rows = {each["name"]: each["value"] for each in json.loads(path.read_text())}
    assert rows == {"services: Read": 1.0, "services: Call": 3.0}
