"""Robots that come and go while the fleet is at work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from tests.unit.fleet.fleet_of import BRIDGE, DOUBLE, INT32, METADATA, Fleet, fleet_config, metadata_of, values
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import UnknownSources
from ua_fleet.counters import Drop
from ua_fleet.fleet import Commands, RobotModel, RobotState, SourceQuarantined, SourceRemoved
from ua_fleet.fleet.changes import RobotAdded, RobotRemoved, SourceReleased
from ua_fleet.fleet.members import RobotLiveness
from ua_fleet.fleet.model import FleetModel
from ua_fleet.pubsub.events import SourceSilent
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode

HEIGHT = Topic(2, 2, 1101)
STATUS = Topic(2, 2, 1110)
LIFT: Mapping[str, Any] = {
    "bridge": "mobile",
    "data": {
        "height": {"id": HEIGHT.id, "type": "Double"},
        "target": {"id": 1102, "type": "Double", "origin": "server", "initial": 0.5},
    },
    "skill_status_id": STATUS.id,
    "skills": {"raise": {"id": 1111}},
}
METERS = metadata_of(make_field("data", DOUBLE))
STATE = "Robots.lift.State"


def robot(**changed: Any) -> RobotModel:
    return fleet_model(fleet_config({"lift": {**LIFT, **changed}})).robots[0]


def state_of(changes: Any) -> RobotState | None:
    shown = values(changes).get(STATE)
    return None if shown is None else RobotState(shown[0])


def test_a_robot_that_comes_is_followed_like_any_other() -> None:
    fleet, lift = Fleet(), robot()
    assert fleet.state.add_robot(lift) == [RobotAdded(lift)]
    assert state_of(fleet.state.tick(1)) is RobotState.OFFLINE
    heard = fleet.hear(HEIGHT, [DOUBLE], [1.5], metadata=METERS)
    assert values(heard)[HEIGHT.id] == (1.5, 0, 1)
    assert state_of(heard) is RobotState.IDLE
    assert state_of(fleet.state.set_busy(STATUS, ("lift",), 2)) is RobotState.BUSY
    assert fleet.state.remove_robot("lift") == [RobotRemoved(lift)]
    assert fleet.state.set_busy(STATUS, (), 3) == []
    assert fleet.state.set_faulted("lift", True, 3) == []
    assert STATE not in values(fleet.state.tick(4))
    fleet.hear(HEIGHT, [DOUBLE], [1.5], 2, metadata=METERS)
    assert fleet.counters.drops[Drop.UNKNOWN_SOURCE] == 1


@pytest.mark.parametrize("policy", [UnknownSources.CREATE, UnknownSources.QUARANTINE])
def test_what_was_discovered_before_is_the_robots_own_now(policy: UnknownSources) -> None:
    fleet = Fleet(policy, max_sources=1)
    found = fleet.hear(HEIGHT, [DOUBLE], [1.0], metadata=METERS)
    changes = fleet.state.add_robot(robot())
    if policy is UnknownSources.CREATE:
        assert isinstance(changes[0], SourceRemoved)
        assert changes[0].data_set.topic == HEIGHT
    else:
        assert any(isinstance(change, SourceQuarantined) for change in found)
        assert changes[0] == SourceReleased(HEIGHT)
    assert isinstance(changes[1], RobotAdded)
    assert fleet.state.knows(HEIGHT)
    other = Topic(2, 2, 1200)  # there is room for another one again
    assert fleet.hear(other, [DOUBLE], [1.0], metadata=METERS)


def test_an_id_has_one_owner() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    stranger = Topic(7, 2, HEIGHT.id)
    fleet.hear(stranger, [DOUBLE], [1.0], metadata=METERS)
    assert fleet.state.owner(2, HEIGHT.id) == stranger
    assert not fleet.state.knows(stranger)
    assert fleet.state.owner(2, 1999) is None


def test_a_robot_of_a_bridge_that_nobody_knows_is_there_while_its_skill_status_is() -> None:
    fleet, lift = Fleet(), robot(data={})
    fleet.state.add_robot(replace(lift, bridge=""))
    assert state_of(fleet.state.tick(1)) is RobotState.OFFLINE
    said = metadata_of(make_field("Skill", BuiltinType.STRING, array=True))
    assert state_of(fleet.hear(STATUS, [DOUBLE], [1.0], metadata=said)) is RobotState.IDLE
    assert state_of(fleet.state.apply(SourceSilent(STATUS), 2)) is RobotState.OFFLINE


def test_a_robot_that_says_nothing_but_its_fault_is_heard() -> None:
    """It has sent no data since its bridge and the server were started anew, and has none to send."""
    fleet, fault = Fleet(), Topic(2, 2, 1120)
    fleet.state.add_robot(robot(fault_id=fault.id))
    text = metadata_of(make_field("data", BuiltinType.STRING))
    assert state_of(fleet.state.tick(1)) is RobotState.OFFLINE
    said = metadata_of(make_field("Skill", BuiltinType.STRING, array=True))
    assert state_of(fleet.hear(STATUS, [DOUBLE], [1.0], metadata=said)) is None, "its bridge says so without it"
    assert state_of(fleet.hear(fault, [BuiltinType.STRING], [""], metadata=text)) is RobotState.IDLE
    lost = int(StatusCode.BAD_NO_COMMUNICATION)
    assert state_of(fleet.hear(fault, [BuiltinType.STRING], [""], metadata=text, status=lost)) is RobotState.OFFLINE
    assert state_of(fleet.hear(fault, [BuiltinType.STRING], [""], metadata=text)) is RobotState.IDLE
    assert state_of(fleet.state.apply(SourceSilent(fault), 2)) is RobotState.OFFLINE


def test_offline_goes_before_faulted_and_that_before_busy() -> None:
    fleet = Fleet()
    fleet.state.add_robot(robot())
    fleet.state.tick(1)
    assert fleet.state.set_faulted("lift", True, 1) == []  # it is offline, and stays so
    assert state_of(fleet.hear(HEIGHT, [DOUBLE], [1.0], metadata=METERS)) is RobotState.FAULTED
    assert fleet.state.set_busy(STATUS, ("lift",), 2) == []
    assert state_of(fleet.state.set_faulted("lift", False, 3)) is RobotState.BUSY
    assert state_of(fleet.state.set_faulted("lift", True, 4)) is RobotState.FAULTED
    assert state_of(fleet.state.apply(SourceSilent(HEIGHT), 5)) is RobotState.OFFLINE


def test_a_robot_without_sources_follows_its_bridge() -> None:
    fleet = Fleet()
    fleet.state.add_robot(robot(data={}))
    assert state_of(fleet.state.tick(1)) is RobotState.OFFLINE
    online = fleet.hear(BRIDGE, [int(BuiltinType.BOOLEAN), INT32], [True, 1], metadata=METADATA[BRIDGE])
    assert state_of(online) is RobotState.IDLE


def test_data_for_clients_comes_and_goes() -> None:
    commands, lift = Commands(FleetModel("fleet", 2, (), ())), robot()
    (first,) = commands.add(lift, 7)
    assert (first.topic, first.values, first.timestamp) == (Topic(0, 2, 1102), (0.5,), 7)
    assert [model.topic for model, _ in commands.sources()] == [Topic(0, 2, 1102)]
    target = lift.data_sets[1].fields[0].key
    assert commands.check(target, DOUBLE, 1.0) == 0
    commands.remove(lift)
    assert commands.check(target, DOUBLE, 1.0) != 0
    assert list(commands.sources()) == []


def test_a_robot_of_clients_says_its_own_skill_status() -> None:
    lift = fleet_model(fleet_config({"lift": LIFT})).robots[0]
    own = replace(lift, skill_status=Topic(0, 2, STATUS.id))
    status = own.skill_status_data
    assert status is not None
    assert not status.writable
    assert list(own.actions()) == [Topic(0, 2, 1111)]


def test_a_mistake_about_one_robot_costs_the_others_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It cost all robots their second, and each second."""
    fleet = Fleet()
    fleet.state.add_robot(robot())
    caught: list[str] = []
    fleet.state.caught = lambda loop, error: caught.append(f"{loop}: {error}")
    tick = RobotLiveness.tick

    def mistaken(self: RobotLiveness, wall_ticks: int) -> Any:
        if self.model.name == "lift":
            raise KeyError("lift")
        return tick(self, wall_ticks)

    monkeypatch.setattr(RobotLiveness, "tick", mistaken)
    shown = values(fleet.state.tick(1))
    assert "Robots.rover.State" in shown
    assert STATE not in shown
    assert caught == ["each second: 'lift'"]
