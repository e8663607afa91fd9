"""From facts about sources to changes of nodes."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.unit.fleet.fleet_of import (
    BRIDGE,
    BUSY,
    COUNT,
    DOUBLE,
    FLOATS,
    INT32,
    METADATA,
    POSE,
    RANGES,
    SPEED,
    STATUS,
    STRING,
    Fleet,
    metadata_of,
    notices,
    values,
)
from ua_fleet.counters import Drop
from ua_fleet.fleet import RobotState, ValueChanged
from ua_fleet.pubsub.events import (
    DataReceived,
    MetaDataReceived,
    ProbeReceived,
    SourceAppeared,
    SourceReturned,
    SourceSilent,
    SourceStale,
)
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, TICKS_PER_SECOND, BuiltinType, StatusCode
from ua_fleet.wire.messages import DataSetMessage, Probe

BAD_NO_COMMUNICATION = StatusCode.BAD_NO_COMMUNICATION


def test_data_becomes_the_value_with_the_robots_time() -> None:
    fleet = Fleet()
    assert values(fleet.speed(0.5, 77))[1001] == (0.5, 0, 77)


def test_several_fields_go_to_their_nodes_by_name() -> None:
    changes = Fleet().hear(POSE, [STRING, DOUBLE], ["map", 1.5], 9)
    assert values(changes)["1003.x"] == (1.5, 0, 9)
    assert values(changes)["1003.frame"] == ("map", 0, 9)


def test_analog_values_may_wait_once_their_quality_is_known() -> None:
    fleet = Fleet()
    waits = [
        change.can_wait
        for change in [*fleet.speed(0.1, 1), *fleet.speed(0.2, 2), *fleet.speed(0.3, 3, status=0x4000_0000)]
        if isinstance(change, ValueChanged) and change.key.identifier == 1001
    ]
    assert waits == [False, True, False]


def test_booleans_never_wait() -> None:
    fleet = Fleet()
    for timestamp in (1, 2):
        changes = fleet.hear(BUSY, [int(BuiltinType.BOOLEAN)], [True], timestamp)
    assert [change.can_wait for change in changes if isinstance(change, ValueChanged)] == [False]


def test_silence_keeps_value_and_time_and_makes_them_bad() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 77)
    changes = fleet.state.apply(SourceSilent(SPEED), fleet.now)
    assert values(changes)[1001] == (0.5, BAD_NO_COMMUNICATION, 77)


def test_a_source_that_returns_has_its_last_value_again() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 77)
    fleet.state.apply(SourceSilent(SPEED), fleet.now)
    changes = fleet.state.apply(SourceReturned(SPEED), fleet.now)
    assert values(changes)[1001] == (0.5, 0, 77)
    assert not fleet.state.apply(SourceReturned(SPEED), fleet.now)


def test_a_source_that_returns_with_a_new_value_never_shows_the_old_one_as_of_now() -> None:
    """That a value was written at once, and the next one up to 100 ms later, made clients read an old one as Good."""
    fleet = Fleet()
    fleet.speed(0.5, 77)
    fleet.state.apply(SourceSilent(SPEED), fleet.now)
    back = fleet.state.apply(SourceReturned(SPEED, is_followed=True), fleet.now)
    assert 1001 not in values(back)
    assert fleet.state.is_alive(SPEED)
    changes = [change for change in fleet.speed(0.6, 78) if isinstance(change, ValueChanged)]
    (new,) = [change for change in changes if change.key.identifier == 1001]
    assert (new.value, new.status, new.can_wait) == (0.6, 0, False)


def test_silence_of_a_source_without_data_goes_back_to_waiting() -> None:
    fleet = Fleet()
    silent = fleet.state.apply(SourceSilent(SPEED), fleet.now)
    assert values(silent)[1001] == (None, BAD_NO_COMMUNICATION, None)
    back = fleet.state.apply(SourceReturned(SPEED), fleet.now)
    assert values(back)[1001] == (None, StatusCode.BAD_WAITING_FOR_INITIAL_DATA, None)


def test_a_source_that_says_it_is_gone_keeps_its_last_values() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 77)
    gone = fleet.speed(0.9, 78, status=int(BAD_NO_COMMUNICATION))
    assert values(gone)[1001] == (0.5, BAD_NO_COMMUNICATION, 77)
    # What it comes back to without new data may be of an earlier life.
    back = fleet.state.apply(SourceStale(SPEED), fleet.now)
    assert values(back)[1001] == (0.5, StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE, 77)
    assert not fleet.state.apply(SourceStale(SPEED), fleet.now)
    assert values(fleet.speed(0.6, 79))[1001] == (0.6, 0, 79)


def test_a_source_that_is_there_with_an_old_value_is_heard_and_its_value_uncertain() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 77)
    old = fleet.state.apply(SourceStale(SPEED), fleet.now)
    assert values(old)[1001] == (0.5, StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE, 77)
    assert fleet.state.is_alive(SPEED)
    fleet.state.apply(SourceSilent(SPEED), fleet.now)
    there = values(fleet.state.apply(SourceStale(SPEED), fleet.now))
    assert there[1001] == (0.5, StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE, 77)
    assert there["Robots.rover.State"][0] == RobotState.IDLE
    assert values(fleet.state.apply(SourceReturned(SPEED), fleet.now))[1001] == (0.5, 0, 77)


def test_an_old_value_that_was_bad_stays_what_it_was() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 1, status=int(StatusCode.BAD_SENSOR_FAILURE))
    assert not fleet.state.apply(SourceStale(SPEED), fleet.now)


def test_another_bad_status_of_a_message_stands_beside_its_value() -> None:
    fleet = Fleet()
    status = int(StatusCode.BAD_SENSOR_FAILURE)
    assert values(fleet.speed(0.5, 1, status=status))[1001] == (0.5, status, 1)


def test_a_bad_field_is_bad_alone() -> None:
    changes = Fleet().hear(POSE, [STRING, STATUS], ["map", int(StatusCode.BAD_TYPE_MISMATCH)], 4)
    assert values(changes)["1003.x"] == (None, StatusCode.BAD_TYPE_MISMATCH, 4)
    assert values(changes)["1003.frame"] == ("map", 0, 4)


def test_fields_with_a_status_and_time_of_their_own() -> None:
    changes = Fleet().hear(
        POSE,
        [STRING, DOUBLE],
        ["map", 1.0],
        4,
        encoding=2,
        field_status=(int(StatusCode.BAD_SENSOR_FAILURE), 0),
        field_source_timestamps=(None, 3),
    )
    assert values(changes)["1003.frame"] == ("map", StatusCode.BAD_SENSOR_FAILURE, 4)
    assert values(changes)["1003.x"] == (1.0, 0, 3)


@pytest.mark.parametrize("value", [2.5, -2.5, math.inf, math.nan])
def test_outside_the_range_is_uncertain_with_its_value(value: float) -> None:
    fleet = Fleet()
    changes = fleet.speed(value, 1)
    shown, status, _ = values(changes)[1001]
    assert shown is value
    assert status == StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED
    assert len(notices(changes)) == 1
    assert notices(fleet.speed(value, 2)) == []
    assert notices(fleet.speed(0.0, 3)) == ["ua_2_2_1001 speed (Double) fits its node again"]


def test_a_value_at_the_edge_of_its_range_does_not_flood_the_log() -> None:
    fleet = Fleet()
    told: list[str] = []
    for number in range(100):
        fleet.now = number * TICKS_PER_SECOND
        told += notices(fleet.speed(2.5 if number % 2 else 1.5, number))
    assert len(told) == 4
    assert [text.endswith("fits its node again") for text in told] == [False, True] * 2


@pytest.mark.parametrize(
    ("topic", "type_code", "value"),
    [
        (COUNT, DOUBLE, math.nan),
        (COUNT, DOUBLE, 1.0),
        (SPEED, STRING, "fast"),
        (SPEED, DOUBLE | ARRAY, (1.0,)),
        (RANGES, DOUBLE, 1.0),
        (BUSY, INT32, 1),
    ],
)
def test_a_value_of_another_type_is_bad_counted_and_told_once(topic: Topic, type_code: int, value: Any) -> None:
    fleet = Fleet()
    metadata = metadata_of(make_field("data", type_code & 0x3F, array=bool(type_code & ARRAY)))
    changes = fleet.hear(topic, [type_code], [value], 5, metadata=metadata)
    assert values(changes)[topic.id] == (None, StatusCode.BAD_TYPE_MISMATCH, 5)
    assert "does not fit its node (BadTypeMismatch)" in notices(changes)[0]
    assert notices(fleet.hear(topic, [type_code], [value], 6, metadata=metadata)) == []
    assert fleet.counters.drops[Drop.CONVERSION] == 2
    # The rest goes on.
    assert values(fleet.hear(POSE, [STRING, DOUBLE], ["map", 1.0], 7))["1003.x"] == (1.0, 0, 7)


def test_an_array_of_another_length_than_announced_is_bad() -> None:
    from ua_fleet.config.schema import UnknownSources

    fleet = Fleet(UnknownSources.CREATE)
    topic = Topic(2, 2, 500)
    field = make_field("ranges", BuiltinType.FLOAT, array=True)._replace(array_dimensions=(3,))
    metadata = metadata_of(field)
    assert values(fleet.hear(topic, [FLOATS], [(1.0, 2.0, 3.0)], 1, metadata=metadata))[500][1] == 0
    changes = fleet.hear(topic, [FLOATS], [(1.0, 2.0)], 2, metadata=metadata)
    assert values(changes)[500] == (None, StatusCode.BAD_OUT_OF_RANGE, 2)
    assert notices(fleet.hear(topic, [FLOATS], [(1.0,)], 3, metadata=metadata)) == []
    assert fleet.counters.drops[Drop.CONVERSION] == 2


def test_a_field_that_the_messages_do_not_have_is_bad() -> None:
    fleet = Fleet()
    metadata = metadata_of(make_field("x", DOUBLE), make_field("y", DOUBLE))
    changes = fleet.state.apply(MetaDataReceived(POSE, metadata), fleet.now)
    assert values(changes)["1003.frame"] == (None, StatusCode.BAD_CONFIGURATION_ERROR, None)
    assert "no such field, but x, y" in notices(changes)[0]
    assert values(fleet.hear(POSE, [DOUBLE, DOUBLE], [1.0, 2.0], 3, metadata=metadata))["1003.x"] == (1.0, 0, 3)


def test_another_layout_is_followed() -> None:
    fleet = Fleet()
    fleet.hear(POSE, [STRING, DOUBLE], ["map", 1.0], 1)
    metadata = metadata_of(make_field("x", DOUBLE), make_field("frame", STRING), version=2)
    assert values(fleet.hear(POSE, [DOUBLE, STRING], [2.0, "odom"], 2, metadata=metadata)) | {} == {
        "1003.x": (2.0, 0, 2),
        "1003.frame": ("odom", 0, 2),
    }


def test_a_second_claimant_is_counted_and_never_shown() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 1)
    other = SPEED._replace(space=3)
    first = fleet.state.apply(MetaDataReceived(other, METADATA[SPEED]), fleet.now)
    assert notices(first) == ["ua_3_2_1001 claims the node of ua_2_2_1001: give one of them another id"]
    for timestamp in (2, 3):
        data = DataSetMessage(1, types=(DOUBLE,), values=(9.0,), timestamp=timestamp)
        assert fleet.state.apply(DataReceived(other, data, METADATA[SPEED]), fleet.now) == []
    assert fleet.counters.drops[Drop.CONFLICT] == 2
    assert fleet.counters.drops[Drop.UNKNOWN_SOURCE] == 0


def test_a_message_that_is_delivered_twice_counts_as_looped() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 10)
    fleet.speed(0.6, 9)
    assert fleet.counters.looped == 0
    fleet.speed(0.5, 10)
    assert fleet.counters.looped == 1


def test_a_clients_own_write_coming_back_counts_as_looped() -> None:
    fleet = Fleet()
    goal = Topic(0, 2, 1006)
    fleet.state.delivered(goal, 50)
    fleet.hear(goal, [DOUBLE], [0.5], 50, metadata=METADATA[SPEED])
    assert fleet.counters.looped == 1


def test_a_robot_is_offline_until_heard_and_when_all_its_sources_are_silent() -> None:
    fleet = Fleet()

    def state() -> Any:
        return values(fleet.state.tick(fleet.now)).get("Robots.rover.State", (None,))[0]

    assert state() == RobotState.OFFLINE
    assert values(fleet.speed(0.5, 1))["Robots.rover.State"][0] == RobotState.IDLE
    fleet.hear(COUNT, [INT32], [1], 1)
    assert "Robots.rover.State" not in values(fleet.state.apply(SourceSilent(SPEED), fleet.now))
    assert values(fleet.state.apply(SourceSilent(COUNT), fleet.now))["Robots.rover.State"][0] == RobotState.OFFLINE
    assert values(fleet.state.apply(SourceReturned(SPEED), fleet.now))["Robots.rover.State"][0] == RobotState.IDLE


def test_a_robot_is_idle_once_a_source_is_there_that_has_said_nothing() -> None:
    fleet = Fleet()
    appeared = values(fleet.state.apply(SourceAppeared(SPEED), fleet.now))
    assert appeared["Robots.rover.State"][0] == RobotState.IDLE
    assert SPEED.id not in appeared, "it is Bad_WaitingForInitialData still"
    silent = values(fleet.state.apply(SourceSilent(SPEED), fleet.now))
    assert silent["Robots.rover.State"][0] == RobotState.OFFLINE
    assert fleet.state.apply(SourceAppeared(Topic(9, 2, 9)), 1) == []


def test_a_source_that_appears_anew_never_makes_its_old_value_good() -> None:
    """Its writer was forgotten meanwhile, or its robot registered anew."""
    fleet = Fleet()
    fleet.speed(0.5, 77)
    fleet.state.apply(SourceSilent(SPEED), fleet.now)
    back = values(fleet.state.apply(SourceAppeared(SPEED), fleet.now))
    assert back[1001] == (0.5, StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE, 77)


def test_silence_of_a_robot_is_told_once_each_way() -> None:
    fleet = Fleet()
    fleet.speed(0.5, 1)
    fleet.hear(COUNT, [INT32], [1], 1)
    assert notices(fleet.state.tick(1)) == []
    fleet.state.apply(SourceSilent(SPEED), fleet.now)
    assert notices(fleet.state.tick(2)) == ["robot rover is silent in part: speed"]
    assert notices(fleet.state.tick(3)) == []
    fleet.state.apply(SourceSilent(COUNT), fleet.now)
    assert notices(fleet.state.tick(4)) == ["robot rover is silent: its nodes are Bad_NoCommunication"]
    fleet.state.apply(SourceReturned(SPEED), fleet.now)
    fleet.state.apply(SourceReturned(COUNT), fleet.now)
    assert notices(fleet.state.tick(5)) == ["robot rover is there, with all its sources"]


def test_last_update_moves_with_each_tick_at_most() -> None:
    fleet = Fleet()
    fleet.now = 5
    fleet.speed(0.5, 1)
    fleet.now = 6
    fleet.speed(0.6, 2)
    assert values(fleet.state.tick(7))["Robots.rover.LastUpdate"] == (6, 0, 7)
    assert "Robots.rover.LastUpdate" not in values(fleet.state.tick(8))


def test_a_bridges_status_goes_to_its_object() -> None:
    fleet = Fleet()
    started = values(fleet.state.tick(1))
    assert started["1900.Online"] == (False, 0, 1)
    changes = fleet.hear(BRIDGE, [int(BuiltinType.BOOLEAN), int(BuiltinType.UINT64)], [True, 12], 3)
    assert values(changes)["1900.Connected"] == (True, 0, 3)
    assert values(changes)["1900.MessagesIn"] == (12, 0, 3)
    assert values(changes)["1900.Online"][0] is True
    assert values(fleet.state.tick(9))["1900.LastSeen"] == (1000, 0, 9)
    silent = fleet.state.apply(SourceSilent(BRIDGE), 99)
    assert values(silent)["1900.Online"] == (False, 0, 99)
    assert values(silent)["1900.MessagesIn"] == (12, BAD_NO_COMMUNICATION, 3)
    assert notices(silent) == ["bridge mobile is silent: its status is Bad_NoCommunication"]


def test_the_servers_own_counters_are_told_when_they_move() -> None:
    fleet = Fleet()
    fleet.counters.messages_in = 3
    fleet.counters.drop(Drop.LOOP)
    first = values(fleet.state.tick(1))
    assert first["Fleet.Traffic.MessagesIn"] == (3, 0, 1)
    assert first["Fleet.Traffic.Drops.loop"] == (1, 0, 1)
    assert first["Fleet.Traffic.Drops.late"] == (0, 0, 1)
    fleet.counters.drop(Drop.LOOP)
    assert values(fleet.state.tick(2)) == {"Fleet.Traffic.Drops.loop": (2, 0, 2)}


def test_events_that_are_not_about_nodes_change_nothing() -> None:
    fleet = Fleet()
    assert fleet.state.apply(ProbeReceived(Probe(0, 1, 2)), 1) == []
    assert fleet.state.apply(SourceSilent(Topic(9, 2, 9)), 1) == []
    assert fleet.state.apply(SourceReturned(Topic(9, 2, 9)), 1) == []
