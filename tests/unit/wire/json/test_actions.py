"""Action requests and responses as JSON (OPC 10000-14 7.2.5.6), with the same class as in UADP."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import orjson
import pytest
from asyncua import ua as typed_ua

from tests.unit.wire.json.samples import NOON, VERSION
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire import ActionMessage, ActionState, Codec
from ua_fleet.wire import encode_action as encode_uadp_action
from ua_fleet.wire.json import DataSetFields, Form, JsonAction, JsonCause, Leniency, decode_json, encode_action
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData, PublisherIdType

ua: Any = typed_ua
FIELDS = DataSetFields(DataSetMetaData("go", (FieldMetaData("x", 11), FieldMetaData("name", 12)), VERSION))
WITH_TARGET = DataSetFields(
    FIELDS.metadata._replace(fields=(*FIELDS.metadata.fields, FieldMetaData("target", 11, value_rank=1)))
)

REQUEST = ActionMessage(
    "2",
    None,
    1600,
    1,
    7,
    ActionState.EXECUTING,
    True,
    "0.server",
    b"\0" * 16,
    "opcua/json/action-response/0",
    1500.0,
    (11, 12),
    (1.5, "dock"),
    timestamp=NOON,
    publisher_id_type=PublisherIdType.STRING,
    major_version=VERSION.major,
)
RESPONSE = REQUEST._replace(
    is_request=False,
    response_address=None,
    timeout_hint_ms=None,
    status=0x8031_0000,
    action_state=ActionState.DONE,
    types=(),
    values=(),
)


def fields_of(_publisher_id: str, _writer_id: int, _is_request: bool) -> DataSetFields:
    return FIELDS


def no_fields(_publisher_id: str, _writer_id: int, _is_request: bool) -> None:
    return None


def decode(text: bytes, fields: Any = fields_of) -> JsonAction:
    decoded = decode_json(text, action_fields_of=fields)
    assert isinstance(decoded, JsonAction)
    return decoded


def with_target(*_: Any) -> DataSetFields:
    return WITH_TARGET


@pytest.mark.parametrize("form", list(Form))
@pytest.mark.parametrize("message", [REQUEST, RESPONSE, REQUEST._replace(others=(REQUEST._replace(request_id=8),))])
def test_both_ways(message: ActionMessage, form: Form) -> None:
    action = JsonAction(message, "m-1", NOON + 1)
    back = decode(encode_action(action, [FIELDS] * (1 + len(message.others)), form))
    assert back.message == message
    assert (back.message_id, back.timestamp, back.leniencies) == ("m-1", NOON + 1, {})


def test_a_request_and_a_response_as_text() -> None:
    request = json.loads(encode_action(JsonAction(REQUEST, "m-1", NOON), [FIELDS]))
    assert request == {
        "MessageId": "m-1",
        "MessageType": "ua-action-request",
        "PublisherId": "2",
        "Timestamp": "2024-01-17T21:20:00Z",
        "ResponseAddress": "opcua/json/action-response/0",
        "CorrelationData": "AAAAAAAAAAAAAAAAAAAAAA==",
        "RequestorId": "0.server",
        "TimeoutHint": 1500.0,
        "Messages": [
            {
                "DataSetWriterId": 1600,
                "ActionTargetId": 1,
                "MetaDataVersion": {"MajorVersion": VERSION.major, "MinorVersion": VERSION.minor},
                "Timestamp": "2024-01-17T21:20:00Z",
                "MessageType": "ua-action-request",
                "RequestId": 7,
                "ActionState": 1,
                "Payload": {"x": 1.5, "name": "dock"},
            }
        ],
    }
    names = [field.name for field in dataclasses.fields(ua.JsonActionNetworkMessage)]
    assert list(request) == names
    response = json.loads(encode_action(JsonAction(RESPONSE, "m-2", NOON), [FIELDS]))
    assert response["Messages"][0]["Status"] == {"Code": 0x8031_0000}
    assert not {"ResponseAddress", "TimeoutHint"} & set(response)
    for tree, theirs in ((request, ua.JsonActionRequestMessage), (response, ua.JsonActionResponseMessage)):
        order = [field.name for field in dataclasses.fields(theirs)]
        members = list(tree["Messages"][0])
        assert members == [name for name in order if name in members]


def test_json_becomes_uadp_and_uadp_json() -> None:
    datagram = encode_uadp_action(REQUEST._replace(publisher_id=2, publisher_id_type=PublisherIdType.UINT16))
    heard = Codec().decode(datagram)
    assert isinstance(heard, ActionMessage)
    back = decode(encode_action(JsonAction(heard, "m-1", NOON), [FIELDS])).message
    assert encode_uadp_action(back._replace(publisher_id=2, publisher_id_type=PublisherIdType.UINT16)) == datagram


def test_without_metadata_a_payload_stays_text() -> None:
    text = encode_action(JsonAction(REQUEST, "m-1", NOON), [FIELDS])
    back = decode(text, no_fields)
    assert back.message.types == ()
    (payload,) = back.payloads
    assert payload is not None
    assert json.loads(payload) == {"x": 1.5, "name": "dock"}
    assert json.loads(encode_action(back, [None])) == json.loads(text) | {
        "Messages": [
            json.loads(text)["Messages"][0]
            | {"MetaDataVersion": {"MajorVersion": 800_000_000, "MinorVersion": 800_000_000}}
        ]
    }


def test_the_list_of_the_table_is_read_too() -> None:
    tree = json.loads(encode_action(JsonAction(REQUEST, "m-1", NOON), [FIELDS]))
    tree["Message"] = tree.pop("Messages")
    back = decode(orjson.dumps(tree))
    assert back.message == REQUEST
    assert back.leniencies == {Leniency.MESSAGE_MEMBER: 1}


@pytest.mark.parametrize(
    ("head", "part", "cause"),
    [
        ({"TimeoutHint": -1}, {}, JsonCause.ACTION),
        ({"TimeoutHint": "soon"}, {}, JsonCause.ACTION),
        ({"RequestorId": "x" * 257}, {}, JsonCause.ACTION),
        ({"RequestorId": []}, {}, JsonCause.SHAPE),
        ({"CorrelationData": "A" * 400}, {}, JsonCause.ACTION),
        ({"CorrelationData": 5}, {}, JsonCause.VALUE_TYPE),
        ({"ResponseAddress": 5}, {}, JsonCause.SHAPE),
        ({"PublisherId": None}, {}, JsonCause.MISSING),
        ({"Messages": []}, {}, JsonCause.MISSING),
        ({"Messages": [5]}, {}, JsonCause.SHAPE),
        ({}, {"ActionState": 3}, JsonCause.ACTION),
        ({}, {"RequestId": 65536}, JsonCause.VALUE_RANGE),
        ({}, {"MessageType": "ua-action-response"}, JsonCause.MESSAGE_TYPE),
        ({}, {"Payload": []}, JsonCause.SHAPE),
        ({}, {"Payload": {"x": "fast"}}, JsonCause.VALUE_TEXT),
        ({}, {"Payload": {"x": {"Value": 5.0, "Status": {"Code": 0x8031_0000}}, "name": "dock"}}, JsonCause.ACTION),
        ({}, {"Payload": {"x": {"Value": 5.0, "Status": {"Code": 0x4000_0000}}, "name": "dock"}}, JsonCause.ACTION),
        ({}, {"Payload": {"x": 5.0, "name": "dock", "target": [100.0, None]}}, JsonCause.ACTION),
    ],
)
def test_what_is_refused(head: dict[str, Any], part: dict[str, Any], cause: JsonCause) -> None:
    tree = json.loads(encode_action(JsonAction(REQUEST, "m-1", NOON), [FIELDS]))
    tree["Messages"][0] |= part
    with pytest.raises(RemoteWireError) as caught:
        decode(orjson.dumps(tree | head), with_target)
    assert caught.value.cause == cause


@pytest.mark.parametrize(
    ("of_field", "of_action", "status"),
    [
        (0x8031_0000, 0, 0x8031_0000),
        (0x8031_0000, 0x4000_0000, 0x8031_0000),
        (0x4000_0000, 0x8031_0000, 0x8031_0000),
        (0x00BA_0000, 0, 0),
    ],
)
def test_a_response_is_as_bad_as_its_worst_result(of_field: int, of_action: int, status: int) -> None:
    tree = json.loads(encode_action(JsonAction(RESPONSE, "m-1", NOON), [FIELDS]))
    payload = {"x": {"Value": 5.0, "Status": {"Code": of_field}}, "name": "dock"}
    tree["Messages"][0] |= {"Payload": payload, "Status": {"Code": of_action}}
    message = decode(orjson.dumps(tree)).message
    assert (message.values, message.status) == ((5.0, "dock"), status)


@pytest.mark.parametrize(
    "action",
    [
        JsonAction(REQUEST, None, NOON),
        JsonAction(REQUEST, "m-1"),
        JsonAction(REQUEST._replace(response_address=None), "m-1", NOON),
        JsonAction(REQUEST._replace(timeout_hint_ms=-1.0), "m-1", NOON),
        JsonAction(REQUEST._replace(action_state=3), "m-1", NOON),
        JsonAction(REQUEST._replace(correlation_data=b"x" * 257), "m-1", NOON),
    ],
)
def test_our_own_mistakes_are_local(action: JsonAction) -> None:
    with pytest.raises(LocalWireError):
        encode_action(action, [FIELDS])
