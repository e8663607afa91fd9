"""Faults that conditions find."""

from __future__ import annotations

from ua_fleet.orchestrator import FaultConditions, FaultFound, FaultRule
from ua_fleet.scenario import Value, ValueUnknown, parse_expression

LOW = FaultRule(
    "battery_low", ("ur3", "rover"), parse_expression("battery < 20"), parse_expression("battery > 30"), "low"
)
HOT = FaultRule("hot", ("ur3",), parse_expression("ur3.temperature > 80"))


class Values(dict[str, Value]):
    def look_up(self, name: str) -> Value:
        if name not in self:
            raise ValueUnknown(f"{name} is not known")
        return self[name]


def test_a_condition_is_told_when_it_changes_and_each_robot_has_its_own() -> None:
    conditions, values = FaultConditions([LOW, HOT]), Values({"ur3.battery": 50.0, "rover.battery": 50.0})
    assert conditions.names == {"battery_low", "hot"}
    assert conditions.check(values.look_up) == []
    values["rover.battery"] = 10.0
    assert conditions.check(values.look_up) == [FaultFound("rover", "battery_low", True, "low")]
    assert conditions.check(values.look_up) == []
    values["rover.battery"] = 25.0
    assert conditions.check(values.look_up) == [], "between both limits it stays as it was"
    values["rover.battery"] = 31.0
    assert conditions.check(values.look_up) == [FaultFound("rover", "battery_low", False, "low")]


def test_what_is_not_known_changes_nothing() -> None:
    conditions, values = FaultConditions([HOT]), Values({"ur3.temperature": 90.0})
    assert conditions.check(values.look_up) == [FaultFound("ur3", "hot", True, "ur3.temperature > 80")]
    del values["ur3.temperature"]
    assert conditions.check(values.look_up) == []
    values["ur3.temperature"] = "broken"
    assert conditions.check(values.look_up) == []
    values["ur3.temperature"] = 20.0
    assert conditions.check(values.look_up) == [FaultFound("ur3", "hot", False, "ur3.temperature > 80")]


def test_a_fault_of_the_run_before_is_over_when_its_condition_is() -> None:
    conditions, values = FaultConditions([HOT]), Values({"ur3.temperature": 20.0})
    conditions.restored("ur3", "hot")
    assert conditions.check(values.look_up) == [FaultFound("ur3", "hot", False, "ur3.temperature > 80")]


def test_a_value_of_another_robot_has_its_name_before_it() -> None:
    jam = FaultRule("jam", ("ur3", "rover"), parse_expression("belt.load > 5 and battery > 0"))
    conditions, values = FaultConditions([jam]), Values({"belt.load": 9.0, "ur3.battery": 1.0, "rover.battery": 0.0})
    assert conditions.check(values.look_up) == [FaultFound("ur3", "jam", True, "belt.load > 5 and battery > 0")]
