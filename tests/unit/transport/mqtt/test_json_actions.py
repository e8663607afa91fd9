"""Actions as JSON over a broker: by name, in time, and only where they are wanted."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.unit.pubsub.publishing import WALL, only
from tests.unit.transport.mqtt.json_connection import Process
from ua_fleet.counters import Drop
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.events import ActionReceived, AnnouncementReceived
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.core import Outgoing
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType
from ua_fleet.wire import encode_action
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget

ACTION = Topic(1, 2, 1010)
ARGUMENTS = (make_field("what", BuiltinType.STRING), make_field("strength", BuiltinType.DOUBLE))
RESULTS = (make_field("seconds", BuiltinType.DOUBLE),)
REQUESTS, RESPONSES = "opcua/json/action-request/1/actions-2", "opcua/json/action-response/1/actions-2"
STRING, DOUBLE, BYTE, BYTES = (
    int(kind) for kind in (BuiltinType.STRING, BuiltinType.DOUBLE, BuiltinType.BYTE, BuiltinType.BYTE_STRING)
)
REQUEST = ActionMessage(
    1,
    ACTION.ns,
    ACTION.id,
    1,
    7,
    ActionState.EXECUTING,
    True,
    requestor_id="0.server",
    correlation_data=bytes(range(16)),
    timeout_hint_ms=1000.0,
    types=(STRING, DOUBLE),
    values=("weld", 0.5),
    timestamp=WALL,
)
ANSWER = REQUEST._replace(
    is_request=False,
    timeout_hint_ms=None,
    action_state=ActionState.DONE,
    types=(BYTE, STRING, DOUBLE),
    values=(3, "done", 4.5),
    status=0,
)


class Pair:
    """A responder of space 1 and the server, which knows its Action."""

    def __init__(self, *, has_actions: bool = True) -> None:
        self.bridge, self.server = Process(1, has_actions=has_actions), Process(0, has_actions=has_actions)
        announced = self.bridge.publisher.announce_action(
            ACTION, "work", (ActionTarget(1, "arm"),), ARGUMENTS, RESULTS, now=100.0, wall_ticks=WALL
        )
        self.announced = self.bridge.send(announced)
        self.heard = self.server.hear_all(self.announced)

    def ask(self, request: ActionMessage = REQUEST) -> list[Outgoing]:
        return self.server.send([encode_action(request)])

    def asked(self, topic: str, text: bytes | Any, **options: bool) -> list[ActionMessage]:
        return [event.message for event in only(ActionReceived, self.bridge.hear(topic, text, **options))]


def test_an_action_is_announced_with_the_fields_that_its_responses_have() -> None:
    pair = Pair()
    (text,) = [json.loads(each.payload) for each in pair.announced if each.topic.startswith("opcua/json/action-meta")]
    names = [field["Name"] for field in text["Response"]["Fields"]]
    assert names == ["ExecutionState", "ExecutionMessage", "seconds"]
    (known,) = [event.announcement for event in only(AnnouncementReceived, pair.heard)]
    assert isinstance(known, ActionMetaDataAnnouncement)
    assert (known.request.fields, known.response.fields) == (ARGUMENTS, RESULTS)


def test_a_request_and_its_answer_come_through_by_name() -> None:
    pair = Pair()
    (sent,) = pair.ask()
    text = json.loads(sent.payload)
    assert (sent.topic, sent.is_retained, sent.expiry_s) == (REQUESTS, False, 1)
    assert (text["MessageType"], text["ResponseAddress"]) == ("ua-action-request", RESPONSES)
    assert text["Messages"][0]["Payload"] == {"what": "weld", "strength": 0.5}
    (asked,) = pair.asked(sent.topic, sent.payload)
    assert asked == REQUEST._replace(response_address=RESPONSES)
    (answer,) = pair.bridge.send([encode_action(ANSWER)], (RESPONSES, 0))
    assert answer.topic == RESPONSES
    said = json.loads(answer.payload)["Messages"][0]["Payload"]
    assert said == {"ExecutionState": 3, "ExecutionMessage": "done", "seconds": 4.5}
    (event,) = only(ActionReceived, pair.server.hear(answer.topic, answer.payload))
    assert event.message == ANSWER


@pytest.mark.parametrize(
    "answer",
    [
        ANSWER._replace(types=(BYTE, STRING), values=(2, "it begins"), action_state=ActionState.EXECUTING),
        ANSWER._replace(types=(), values=(), status=0x808B_0000),
        ANSWER._replace(types=(DOUBLE,), values=(4.5,)),
    ],
    ids=["without results", "refused by its Status", "of a foreign responder"],
)
def test_an_answer_has_the_fields_that_were_there(answer: ActionMessage) -> None:
    pair = Pair()
    (sent,) = pair.bridge.send([encode_action(answer)], (RESPONSES, 0))
    (event,) = only(ActionReceived, pair.server.hear(sent.topic, sent.payload))
    assert (event.message.types, event.message.values) == (answer.types, answer.values)
    assert event.message.status == answer.status


@pytest.mark.parametrize(("types", "values"), [((), ()), ((BYTES,), (bytes(16),))], ids=["halt", "suspend"])
def test_a_request_about_an_execution_comes_through(types: tuple[int, ...], values: tuple[Any, ...]) -> None:
    pair = Pair()
    (sent,) = pair.ask(REQUEST._replace(action_target_id=0xC001, types=types, values=values))
    (asked,) = pair.asked(sent.topic, sent.payload)
    assert (asked.action_target_id, asked.types, asked.values) == (0xC001, types, values)


def test_a_request_that_is_past_its_timeout_hint_is_not_sent() -> None:
    pair = Pair()
    late = WALL - round(1.5 * TICKS_PER_SECOND)
    assert pair.ask(REQUEST._replace(timestamp=late)) == []
    assert pair.server.core.take_drops() == {Drop.EXPIRED: 1}


def test_the_time_of_a_request_is_that_of_its_json_timestamp() -> None:
    pair = Pair()
    text = json.loads(pair.ask()[0].payload)
    (part,) = text["Messages"]
    del part["Timestamp"]
    text["Timestamp"] = "2026-01-01T00:00:00Z"
    (asked,) = pair.asked(REQUESTS, text)
    assert asked.timestamp == 134_116_992_000_000_000
    del text["Timestamp"]
    (asked,) = pair.asked(REQUESTS, text)
    assert asked.timestamp is None, "the responder refuses it"


def test_a_retained_request_is_dropped_unread() -> None:
    pair = Pair()
    (sent,) = pair.ask()
    assert pair.asked(sent.topic, sent.payload, is_retained=True) == []
    assert pair.bridge.core.take_drops() == {Drop.RETAINED: 1}


def test_a_request_on_the_topic_of_another_responder_is_dropped() -> None:
    pair = Pair()
    (sent,) = pair.ask()
    assert pair.asked(REQUESTS.replace("/1/", "/2/"), sent.payload) == []
    assert pair.asked(RESPONSES, sent.payload) == []
    assert pair.bridge.core.take_drops() == {Drop.NOT_ITS_TOPIC: 2}


def test_without_actions_none_is_announced_sent_heard_or_taken() -> None:
    request = Pair().ask()[0]
    pair = Pair(has_actions=False)
    assert pair.announced == []
    assert pair.ask() == []
    assert pair.server.core.take_drops() == {Drop.NOT_OVER_JSON: 1}
    assert not [each for each in pair.bridge.core.filters if "action" in each]
    assert pair.asked(request.topic, request.payload) == []


def test_a_request_with_fields_that_are_not_known_is_not_taken() -> None:
    pair, text = Pair(), json.loads(Pair().ask()[0].payload)
    text["Messages"][0]["DataSetWriterId"] = 1011
    assert pair.asked(REQUESTS, text) == []
    assert pair.bridge.core.take_drops() == {Drop.NO_METADATA: 1}
    unknown = Process(0).send([encode_action(REQUEST)])
    assert unknown == [], "nor can it be asked without them"
