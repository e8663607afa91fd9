"""`limits` and `normal` in `fleet.yaml`: what is refused, with file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from ua_fleet.config.load import load
from ua_fleet.config.nodes import fleet_model
from ua_fleet.errors import ConfigInvalid
from ua_fleet.operation.alarms.configured import alarm_definitions
from ua_fleet.operation.alarms.levels import Levels

HEAD = """version: 1
fleet: {name: f}
pubsub: {security: none}
bridges:
  a: {kind: ros1, space: 1, status_id: 1901}
robots:
  r:
    bridge: a
    capacities: [mobile]
    data:
"""


def read(tmp_path: Path, line: str) -> Path:
    file = tmp_path / "fleet.yaml"
    file.write_text(f"{HEAD}      one: {line}\n", encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("{id: 1001, type: Double, limits: {high: 80, high_high: 70}}", "80 must be less than 70"),
        ("{id: 1001, type: Double, limits: {low: 90, high: 80}}", "90 must be less than 80"),
        ("{id: 1001, type: Double, limits: {high: 80, high_high: 90, hysteresis: 10}}", "nearer to each other"),
        ("{id: 1001, type: Double, limits: {high: 1, hysteresis: 2}}", "1 is below the hysteresis 2"),
        ("{id: 1001, type: Double, limits: {low: -1, hysteresis: 2}}", "low -1 is below the hysteresis 2"),
        ("{id: 1001, type: Double, range: [0, 9], limits: {high: 1, hysteresis: 2}}", "would end only at -1"),
        ("{id: 1001, type: Double, limits: {hysteresis: 2}}", "give at least one"),
        ("{id: 1001, type: Double, limits: {high: .nan}}", "limits.high"),
        ("{id: 1001, type: Double, range: [0, 50], limits: {high: 80}}", "outside the range 0 to 50"),
        ("{id: 1001, type: String, limits: {high: 80}}", "String has no limits"),
        ("{id: 1001, type: Double, array: true, limits: {high: 80}}", "an array has no limits"),
        ("{id: 1001, type: Double, normal: false}", "it is for a single Boolean"),
        ("{id: 1001, origin: server, type: Double, limits: {high: 80}}", "data that clients write has no alarms"),
        ("{id: 1001, fields: {x: {type: Double}}, limits: {high: 80}}", "belong to each field"),
        ("{id: 1001, type: Double, limits: {high: 80, fault: [mobil]}}", "lacks the capacity `mobil`"),
    ],
)
def test_what_is_wrong_is_refused_at_its_line(tmp_path: Path, line: str, problem: str) -> None:
    file = read(tmp_path, line)
    with pytest.raises(ConfigInvalid) as told:
        load(file)
    assert f"{file}:11:robots.r.data.one" in str(told.value)
    assert problem in str(told.value)


@pytest.mark.parametrize(
    "line",
    [
        "{id: 1001, type: Double, range: [-5, 5], limits: {high: 1, hysteresis: 2}}",
        "{id: 1001, type: Double, range: [-5, 5], limits: {low: -1, hysteresis: 2}}",
        "{id: 1001, type: Double, limits: {high: -1, hysteresis: 2}}",
        "{id: 1001, type: Double, limits: {low: 1, hysteresis: 2}}",
        "{id: 1001, type: Double, limits: {high: 0, hysteresis: 2}}",
        "{id: 1001, type: Double, limits: {high: 2, hysteresis: 2}}",
    ],
)
def test_a_limit_that_an_alarm_can_come_back_from_is_taken(tmp_path: Path, line: str) -> None:
    """The hysteresis is a distance (the Deadband of OPC 10000-9 5.8.18): nothing says that it is less than a limit."""
    load(read(tmp_path, line))


def test_alarms_of_a_file(tmp_path: Path) -> None:
    limits = "{high: 80, high_high: 90, hysteresis: 2, delay_s: 1, fault: [mobile]}"
    fields = f"{{x: {{type: Double, limits: {limits}}}, door: {{type: Boolean, normal: false}}}}"
    config = load(read(tmp_path, f"{{id: 1001, fields: {fields}}}"))
    found = {one.id: one for one in alarm_definitions(config, fleet_model(config))}
    assert sorted(found) == ["a.Online", "r.one.door", "r.one.x"]
    one = found["r.one.x"]
    assert one.levels == Levels(high=80, high_high=90, hysteresis=2)
    assert (one.robot, one.capacities, one.delay_s) == ("r", ("mobile",), 1)
    assert (one.severity_at(1), one.severity_at(2)) == (500, 700)
    assert found["r.one.door"].normal is False
    assert found["a.Online"].normal is True


def test_two_alarms_of_one_name_are_refused_with_both_places(tmp_path: Path) -> None:
    """One would replace the other: ConditionIds are names."""
    file = tmp_path / "fleet.yaml"
    head = HEAD.replace("  r:\n", "  a:\n")
    file.write_text(f"{head}      Online: {{id: 1001, type: Boolean, normal: true}}\n", encoding="utf-8")
    with pytest.raises(ConfigInvalid) as told:
        load(file)
    assert f"{file}:11:robots.a.data.Online.normal: `a.Online` is an alarm of bridges.a (line 5) already" in str(
        told.value
    )
