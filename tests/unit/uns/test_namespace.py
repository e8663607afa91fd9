"""What is due on the broker, and when; without a broker."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pytest

from tests.unit.fleet.fleet_of import ROBOTS, fleet_config
from ua_fleet.config.nodes import fleet_model
from ua_fleet.counters import Drop
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import RobotModel
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.core import Outgoing
from ua_fleet.uns.namespace import BURST, MOST_PER_S, Namespace
from ua_fleet.uns.payloads import Payload
from ua_fleet.uns.topics import NamespaceTopics
from ua_fleet.values import BuiltinType, NodeId, StatusCode

NOON = 133_500_000_000_000_000
DOUBLE, STATUS = int(BuiltinType.DOUBLE), int(BuiltinType.STATUS_CODE)
BAD = int(StatusCode.BAD_NO_COMMUNICATION)
SPEED, GOAL = NodeId(2, 1001), Topic(0, 2, 1006)
AT = "Hall/rover/"


def rover(robots: Mapping[str, Any] = ROBOTS) -> RobotModel:
    (model,) = fleet_model(fleet_config(robots)).robots
    return model


def make(form: Payload = Payload.VALUE, *, rate_hz: float = 1.0, max_payload_bytes: int = 1000) -> Namespace:
    topics = NamespaceTopics("{fleet}/{robot}/{data}", None, "Hall")
    namespace = Namespace(
        topics,
        form,
        rate_hz=rate_hz,
        expiry_s=180.0,
        max_payload_bytes=max_payload_bytes,
        wall_ticks=lambda: NOON,
    )
    namespace.add(rover())
    return namespace


def sent(namespace: Namespace, now: float = 0.0, *, acknowledge: bool = True) -> list[Outgoing]:
    found = list(namespace.take(now))
    for each in found if acknowledge else ():
        namespace.acknowledged(each.parcel)
    return found


def texts(found: list[Outgoing]) -> dict[str, str]:
    return {each.topic.removeprefix(AT): each.payload.decode() for each in found}


def speed(value: float, status: int = 0, *, can_wait: bool = True) -> ValueChanged:
    return ValueChanged(SPEED, DOUBLE, value, status, NOON, can_wait)


def online(form: Payload = Payload.VALUE, **options: Any) -> Namespace:
    namespace = make(form, **options)
    namespace.connected(0.0)
    sent(namespace)
    return namespace


def test_at_the_connection_every_topic_is_there_and_says_that_nothing_is_known() -> None:
    namespace = make(Payload.OBJECT)
    assert sent(namespace) == [], "there is no connection"
    namespace.connected(0.0)
    found = sent(namespace)
    assert found[0].topic == "Hall/_server"
    assert all(each.is_retained and each.qos == 1 and each.expiry_s == 180 and each.kind is None for each in found)
    shown = texts(found[1:])
    assert set(shown) == {
        *("speed", "busy", "pose.x", "pose.frame", "ranges", "count", "goal"),
        *("_state", "_task", "_fault"),
    }
    assert {json.loads(text)["quality"] for text in shown.values()} == {"BadWaitingForInitialData"}
    assert {json.loads(text)["value"] for text in shown.values()} == {None}
    assert {json.loads(text)["time"] for text in shown.values()} == {"2024-01-17T21:20:00Z"}, "that of the server"
    assert namespace.is_empty
    assert (namespace.topics, namespace.published) == (10, 11)


def test_a_value_its_end_and_its_return() -> None:
    namespace = online()
    namespace.changed(speed(1.5), 0.0)
    assert texts(sent(namespace)) == {"speed": "1.5"}
    namespace.changed(speed(1.5, BAD, can_wait=False), 0.1)
    assert texts(sent(namespace)) == {"speed": "null"}
    namespace.changed(speed(1.5, can_wait=False), 0.2)
    assert texts(sent(namespace)) == {"speed": "1.5"}


def test_a_node_that_is_no_data_of_a_robot_is_not_published() -> None:
    namespace = online()
    namespace.changed(ValueChanged(NodeId(2, "Fleet.Traffic.MessagesIn"), DOUBLE, 1.0, 0, NOON, False), 0.0)
    assert sent(namespace) == []


def test_numbers_wait_for_their_turn_the_last_one_comes_and_the_others_are_counted() -> None:
    namespace = online(rate_hz=1.0)
    for number in range(10):
        namespace.changed(speed(float(number)), number / 100)
    assert texts(sent(namespace)) == {"speed": "0.0"}
    assert namespace.next_deadline() == 1.0
    namespace.poll(0.9)
    assert sent(namespace) == []
    namespace.poll(1.0)
    assert texts(sent(namespace)) == {"speed": "9.0"}
    assert namespace.take_drops() == {Drop.RATE_LIMITED: 8}


def test_while_the_broker_is_away_the_newest_waits_and_the_others_are_counted() -> None:
    namespace = online(rate_hz=1000.0)
    namespace.disconnected()
    for number in range(10):
        namespace.changed(speed(float(number)), 1.0 + number)
    assert sent(namespace, 20.0) == []
    assert namespace.take_drops() == {Drop.BROKER_AWAY: 9}
    namespace.connected(20.0)
    found = sent(namespace, 20.0)
    assert texts(found)["speed"] == "9.0"
    assert len(found) == 11, "everything goes again: the broker may have lost what it retained"
    assert namespace.take_drops() == {}


def test_what_was_in_flight_when_the_connection_broke_is_counted_where_a_newer_value_has_come() -> None:
    namespace = online(rate_hz=1000.0)
    namespace.changed(speed(1.0), 1.0)
    sent(namespace, 1.0, acknowledge=False)
    namespace.changed(speed(2.0), 2.0)
    namespace.disconnected()
    assert namespace.take_drops() == {Drop.BROKER_AWAY: 1}
    namespace.connected(3.0)
    assert texts(sent(namespace, 3.0))["speed"] == "2.0"


def test_the_window_bounds_what_is_in_flight_and_a_silent_broker_is_noticed() -> None:
    namespace = make()
    namespace.connected(0.0, receive_maximum=3)
    first = sent(namespace, 0.0, acknowledge=False)
    assert len(first) == 3
    assert not namespace.is_stuck(5.0)
    assert namespace.is_stuck(5.1)
    namespace.acknowledged(first[0].parcel)
    assert len(sent(namespace, 1.0)) == 1


def test_many_topics_keep_the_server_from_no_other_work_and_new_values_go_first() -> None:
    data = {f"v{number}": {"id": number, "type": "Double"} for number in range(1, 3001)}
    namespace = make()
    namespace.remove("rover")
    namespace.add(rover({"rover": {"bridge": "mobile", "data": data}}))
    namespace.connected(0.0)
    assert len(sent(namespace, 0.0)) == pytest.approx(BURST, abs=1)
    assert len(sent(namespace, 0.0)) <= 1
    assert namespace.next_deadline() == pytest.approx(0.0, abs=1 / MOST_PER_S)
    namespace.changed(ValueChanged(NodeId(2, 3000), DOUBLE, 1.5, 0, NOON, False), 0.1)
    sent(namespace, 0.1)
    namespace.changed(ValueChanged(NodeId(2, 3000), DOUBLE, 2.5, 0, NOON, False), 0.2)
    found = sent(namespace, 0.2)
    assert (found[0].topic, found[0].payload) == (AT + "v3000", b"2.5")
    assert len(found) == pytest.approx(MOST_PER_S * 0.1, abs=1)
    namespace.end()
    said: list[Outgoing] = []
    while found := sent(namespace, 0.2):
        said += found
    assert namespace.is_empty
    assert len(said) == namespace.topics + 1
    assert {each.payload for each in said[1:]} == {b"null"}


def test_values_that_do_not_change_are_said_while_new_ones_never_end() -> None:
    """More of them change in a second than may be sent. What the broker has is of an earlier life of the server."""
    data = {f"v{number}": {"id": number, "type": "Double"} for number in range(1, 3001)}
    namespace = make()
    namespace.remove("rover")
    namespace.add(rover({"rover": {"bridge": "mobile", "data": data}}))
    namespace.connected(0.0)
    said: list[float] = []
    news = 0
    for tenth in range(800):
        now = tenth / 10
        for number in range(1, 2501) if tenth % 10 == 0 else ():
            namespace.changed(ValueChanged(NodeId(2, number), DOUBLE, now, 0, NOON, True), now)
        namespace.poll(now)
        for each in sent(namespace, now):
            news += each.payload not in {b"null", b"online"}
            if each.topic == AT + "v3000":
                said.append(now)
    first, again = said
    assert first <= 3
    assert 60 <= again <= 65, "after a third of the expiry"
    assert news >= 0.9 * 80 * MOST_PER_S, "new values have what is left"


def test_a_refused_message_is_counted() -> None:
    namespace = make()
    namespace.connected(0.0)
    for each in sent(namespace, acknowledge=False):
        namespace.acknowledged(each.parcel, is_refused=True)
    assert namespace.take_drops() == {Drop.BROKER_REFUSED: 11}
    assert namespace.published == 0


def test_what_does_not_change_is_said_again_before_the_broker_forgets_it() -> None:
    namespace = online()
    namespace.changed(speed(1.5), 50.0)
    sent(namespace, 50.0)
    namespace.poll(59.0)
    assert sent(namespace, 59.0) == []
    namespace.poll(60.0)
    assert len(sent(namespace, 60.0)) == 10, "all but the speed, and the server"
    namespace.poll(110.0)
    assert texts(sent(namespace, 110.0)) == {"speed": "1.5"}
    assert namespace.take_drops() == {}


def test_a_value_that_is_too_large_or_cannot_be_written_is_null_and_counted() -> None:
    namespace = online(Payload.OBJECT)
    namespace.changed(ValueChanged(NodeId(2, "1003.frame"), int(BuiltinType.STRING), "x" * 1000, 0, NOON, False), 0.0)
    namespace.changed(ValueChanged(SPEED, DOUBLE, "fast", 0, NOON, False), 0.0)
    shown = {topic: json.loads(text) for topic, text in texts(sent(namespace)).items()}
    assert shown["pose.frame"]["quality"] == "BadRequestTooLarge"
    assert shown["speed"]["quality"] == "BadEncodingError"
    assert {each["value"] for each in shown.values()} == {None}
    assert namespace.take_drops() == {Drop.BROKER_REFUSED: 1, Drop.CONVERSION: 1}
    assert AT + "pose.frame: " in namespace.details["broker_refused"]


def test_data_that_clients_write() -> None:
    namespace = online()
    namespace.written(GOAL, (STATUS,), (int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA),), NOON, 0.0)
    assert texts(sent(namespace)) == {"goal": "null"}
    namespace.written(GOAL, (DOUBLE,), (0.5,), NOON, 0.1)
    assert texts(sent(namespace)) == {"goal": "0.5"}
    namespace.written(Topic(0, 2, 9), (DOUBLE,), (0.5,), NOON, 0.2)
    assert sent(namespace) == []


def test_what_the_server_says_of_a_robot_is_published_when_it_is_new() -> None:
    namespace = online()
    namespace.told("rover", "busy", "drive", "")
    assert texts(sent(namespace)) == {"_state": '"busy"', "_task": '"drive"', "_fault": '""'}
    namespace.told("rover", "faulted", "drive", "motor is hot")
    assert texts(sent(namespace)) == {"_state": '"faulted"', "_fault": '"motor is hot"'}
    namespace.told("nobody", "idle", "", "")
    assert sent(namespace) == []


def test_a_robot_that_goes_is_cleared_and_one_that_comes_back_is_not() -> None:
    namespace = online()
    namespace.changed(speed(1.5), 0.0)
    namespace.changed(speed(2.5), 0.1)
    namespace.remove("rover")
    found = sent(namespace)
    assert {each.payload for each in found} == {b""}
    assert {each.expiry_s for each in found} == {None}
    assert len(found) == 10
    namespace.poll(5.0)
    namespace.changed(speed(3.5), 5.0)
    assert sent(namespace) == []
    namespace.add(rover())
    namespace.remove("rover")
    namespace.add(rover())
    found = sent(namespace)
    assert texts(found)["speed"] == "null"
    assert len(found) == 10


def test_a_topic_that_was_not_cleared_when_the_connection_broke_is_cleared_later() -> None:
    namespace = online()
    namespace.remove("rover")
    sent(namespace, acknowledge=False)
    namespace.disconnected()
    namespace.connected(1.0)
    assert sum(not each.payload for each in sent(namespace)) == 10


def test_at_the_end_nothing_is_of_now_and_the_server_is_offline() -> None:
    namespace = online(Payload.OBJECT)
    namespace.changed(speed(1.5), 0.0)
    sent(namespace)
    namespace.end()
    namespace.end()
    found = sent(namespace, 1.0)
    assert (found[0].topic, found[0].expiry_s) == ("Hall/_server", None)
    assert json.loads(found[0].payload)["value"] == "offline"
    assert {json.loads(text)["value"] for text in texts(found[1:]).values()} == {None}
    assert json.loads(texts(found)["speed"])["quality"] == "BadNoCommunication"
    namespace.changed(speed(2.5), 1.0)
    namespace.told("rover", "idle", "x", "")
    namespace.poll(100.0)
    assert sent(namespace, 100.0) == []


def test_the_will_says_that_the_server_is_offline() -> None:
    assert make().will(0.0) == b'"offline"'
    assert json.loads(make(Payload.OBJECT).will(0.0)) == {"value": "offline", "time": None, "quality": "Good"}


def test_nothing_is_subscribed_to_and_what_comes_all_the_same_is_nothing() -> None:
    namespace = online()
    assert namespace.filters == {}
    assert list(namespace.received(f"{AT}goal", b"1.0", 0.0, is_retained=False)) == []
    assert sent(namespace) == []
