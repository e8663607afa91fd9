"""How good what a robot says is as a whole, and when a list of robots has to look again."""

from __future__ import annotations

from dataclasses import replace

from tests.unit.fleet.fleet_of import BRIDGE, BUSY, DOUBLE, METADATA, POSE, SPEED, STRING, Fleet
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.fleet import FleetState
from ua_fleet.fleet.members import BridgeLiveness, RobotLiveness
from ua_fleet.fleet.moved import MovedRobots
from ua_fleet.pubsub.events import DataReceived, SourceReturned, SourceSilent, SourceStale
from ua_fleet.values import BuiltinType, StatusCode, status_name
from ua_fleet.wire.messages import DataSetMessage

BOOLEAN = int(BuiltinType.BOOLEAN)


def rover(state: FleetState) -> RobotLiveness:
    found = state.robot_status("rover")
    assert found is not None
    return found


def quality(fleet: Fleet) -> str:
    return status_name(fleet.state.quality(rover(fleet.state)))


def moved(fleet: Fleet) -> list[str]:
    return fleet.state.moved.take(100)


def test_what_has_never_come_is_not_good_and_does_not_count_beside_what_has() -> None:
    fleet = Fleet()
    assert quality(fleet) == "BadWaitingForInitialData"
    fleet.speed(0.5)
    assert quality(fleet) == "Good"


def test_the_worst_value_counts() -> None:
    fleet = Fleet()
    fleet.speed(0.5)
    fleet.hear(POSE, [STRING, DOUBLE], ["map", 1.5], status=0x4000_0000)
    assert quality(fleet) == "Uncertain"
    fleet.hear(BUSY, [BOOLEAN], [True])
    fleet.state.apply(SourceSilent(BUSY), fleet.now)
    assert quality(fleet) == "BadNoCommunication"
    fleet.state.apply(SourceReturned(BUSY), fleet.now)
    assert quality(fleet) == "Uncertain"
    fleet.hear(POSE, [STRING, DOUBLE], ["map", 1.5], 2)
    assert quality(fleet) == "Good"


def test_a_value_that_may_be_of_an_earlier_life_is_not_good() -> None:
    fleet = Fleet()
    fleet.speed(0.5)
    fleet.state.apply(SourceStale(SPEED), fleet.now)
    assert quality(fleet) == "UncertainNoCommunicationLastUsableValue"


def test_a_list_has_to_look_again_when_quality_or_state_or_time_have_moved_and_not_for_each_value() -> None:
    fleet = Fleet()
    assert moved(fleet) == ["rover"]
    assert not fleet.state.moved
    fleet.speed(0.5)
    assert moved(fleet) == ["rover"]
    for timestamp in range(2, 50):
        fleet.speed(timestamp / 100, timestamp)
    assert moved(fleet) == []
    fleet.state.tick(fleet.now)
    assert moved(fleet) == ["rover"]  # LastUpdate
    fleet.state.tick(fleet.now)
    assert moved(fleet) == []
    fleet.state.apply(SourceSilent(SPEED), fleet.now)
    assert moved(fleet) == ["rover"]


def test_the_last_update_is_that_of_a_value_and_not_of_the_word_that_the_robot_is_gone() -> None:
    fleet = Fleet()
    fleet.now = 2000
    fleet.speed(0.5)
    fleet.now = 3000
    fleet.state.apply(
        DataReceived(SPEED, DataSetMessage(1, timestamp=9, status=StatusCode.BAD_NO_COMMUNICATION), METADATA[SPEED]),
        fleet.now,
    )
    assert quality(fleet) == "BadNoCommunication"
    assert rover(fleet.state).last_update == 2000


def test_the_skills_that_a_robot_is_at_are_known() -> None:
    raw = {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"mobile": {"kind": "ros2", "space": 2, "status_id": BRIDGE.id}},
        "robots": {"arm": {"bridge": "mobile", "skill_status_id": 50, "skills": {"pick": {"id": 51}}}},
    }
    model = fleet_model(FleetConfig.model_validate(raw))
    state = FleetState(model, Counters())
    arm = state.robot_status("arm")
    assert arm is not None
    status = arm.model.skill_status
    assert status is not None
    state.moved.take(9)
    state.set_busy(status, ("pick",), 5)
    assert (arm.skills, state.moved.take(9)) == (("pick",), ["arm"])
    state.set_busy(status, ("pick",), 6)
    assert state.moved.take(9) == []


def test_a_robot_without_data_of_its_own_is_as_its_bridge_is() -> None:
    raw = {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"mobile": {"kind": "ros2", "space": 2, "status_id": BRIDGE.id}},
        "robots": {"arm": {"bridge": "mobile"}},
    }
    state = FleetState(fleet_model(FleetConfig.model_validate(raw)), Counters())
    arm = state.robot_status("arm")
    assert arm is not None
    assert status_name(state.quality(arm)) == "BadWaitingForInitialData"
    types = [BOOLEAN, int(BuiltinType.UINT64)]
    message = DataSetMessage(BRIDGE.id, types=tuple(types), values=(True, 1), timestamp=1)
    state.apply(DataReceived(BRIDGE, message, METADATA[BRIDGE]), 10)
    assert status_name(state.quality(arm)) == "Good"
    state.apply(SourceSilent(BRIDGE), 20)
    assert status_name(state.quality(arm)) == "BadNoCommunication"
    assert "arm" in state.moved.take(9)


def test_what_nobody_wants_to_be_read_does_not_count_beside_what_is_read() -> None:
    fleet = Fleet()
    not_read = [0, int(StatusCode.UNCERTAIN_LAST_USABLE_VALUE)]
    (bridge,) = fleet.model.bridges
    for on_demand, expected in ((True, "Good"), (False, "UncertainLastUsableValue")):
        status = RobotLiveness(
            fleet.model.robots[0], BridgeLiveness(replace(bridge, reads_on_demand=on_demand)), MovedRobots()
        )
        assert status_name(status.quality_of_values(not_read)) == expected
    alone = RobotLiveness(fleet.model.robots[0], BridgeLiveness(replace(bridge, reads_on_demand=True)), MovedRobots())
    assert status_name(alone.quality_of_values(not_read[1:])) == "UncertainLastUsableValue"


def test_a_robot_that_is_gone_is_told_too() -> None:
    fleet = Fleet()
    fleet.state.moved.take(9)
    fleet.state.remove_robot("rover")
    assert fleet.state.moved.take(9) == ["rover"]
    assert fleet.state.robot_status("rover") is None
