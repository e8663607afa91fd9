"""Capacities that data gives."""

from __future__ import annotations

from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.model import DataSetModel, RobotModel
from ua_fleet.topics import Topic

WARM, COLD = Topic(300, 2, 10), Topic(301, 2, 11)


def robot(name: str, *capacities: str, on: str = "", gives: tuple[Topic, ...] = ()) -> RobotModel:
    data = tuple(DataSetModel(topic, f"t{topic.id}", (), gives=("temperature",)) for topic in gives)
    return RobotModel(name, "pc", "", capacities, data, 2, mounted_on=on)


def test_data_gives_to_its_robot_and_to_who_carries_it() -> None:
    rover, pc = robot("rover", "mobile"), robot("pc", on="rover", gives=(WARM, COLD))
    able = Capacities([rover, pc, robot("other", "mobile")])
    assert able.of("rover") == ("mobile",)
    assert able.lacking("rover") == {"temperature": "pc.t11 is not there"}
    assert able.lacking("other") == able.lacking("nobody") == {}
    changes = able.source_changed(WARM, True)
    assert [(change.robot.name, change.holds, dict(change.lacks)) for change in changes] == [
        ("pc", ("temperature",), {}),
        ("rover", ("mobile", "temperature"), {}),
    ]
    able.source_changed(COLD, True)
    able.source_changed(WARM, False)
    assert able.of("rover") == ("mobile", "temperature")
    able.source_changed(COLD, False)
    assert able.of("rover") == ("mobile",)
    assert able.source_changed(Topic(1, 2, 3), True) == []


def test_a_robot_that_is_gone_gives_nothing() -> None:
    able = Capacities([robot("rover", "mobile")])
    pc = robot("pc", on="rover", gives=(WARM,))
    assert [change.robot.name for change in able.add(pc)] == ["rover"]
    able.source_changed(WARM, True)
    (change,) = able.remove(pc)
    assert (change.robot.name, change.holds, change.lacks) == ("rover", ("mobile",), {})
    assert able.lacking("rover") == {}


def test_nothing_is_kept_of_robots_that_are_gone() -> None:
    able = Capacities()
    for number in range(3):
        pc = robot(f"pc{number}", on="rover", gives=(WARM,))
        able.add(pc)
        able.remove(pc)
    assert vars(able)["_given"] == {}
