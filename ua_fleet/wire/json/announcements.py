"""Discovery and status as JSON (OPC 10000-14 7.2.5.5): `ua-metadata`, `ua-status` and the others, CompactEncoding.

    ua-metadata       MetaDataAnnouncement       ua-connection         ConnectionsAnnouncement of one connection
    ua-application    ApplicationAnnouncement    ua-action-metadata    ActionMetaDataAnnouncement
    ua-endpoints      EndpointsAnnouncement      ua-action-responder   ActionResponderAnnouncement of one connection
    ua-status         StatusAnnouncement

The classes are those of UADP; their SequenceNumber and their statuses have no place in JSON, and are 0 when read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire import discovered as d
from ua_fleet.wire.builtin import MISFITS
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.configuration import (
    ACTION_METHOD,
    ACTION_TARGET,
    APPLICATION_DESCRIPTION,
    CONNECTION,
    ENDPOINT_DESCRIPTION,
)
from ua_fleet.wire.json.dates import decode_date, encode_date
from ua_fleet.wire.json.headers import (
    decode_message_id,
    decode_publisher_id,
    decode_text,
    decode_writer_id,
    encode_publisher_id,
)
from ua_fleet.wire.json.metadata import META_DATA
from ua_fleet.wire.json.parsing import Reading, dump, shown
from ua_fleet.wire.json.records import BOOLEAN, ENUMERATION, TEXT, Member, Record, array
from ua_fleet.wire.json.scalars import SCALAR_ENCODERS
from ua_fleet.wire.messages import DataSetMetaData, MetaDataAnnouncement, PublisherIdType

__all__ = ["ANNOUNCEMENTS", "JsonAnnouncement", "decode_announcement", "encode_announcement"]

_STRING: Final = PublisherIdType.STRING.value


class JsonAnnouncement(NamedTuple):
    """One discovery message, with what only JSON has."""

    announcement: d.AnyAnnouncement
    message_id: str | None = None
    timestamp: int | None = None
    """Ticks, when it was sent first."""
    writer_group_name: str | None = None
    data_set_writer_name: str | None = None
    leniencies: Mapping[Leniency, int] = MappingProxyType({})


class _Kind(NamedTuple):
    """The messages of one MessageType."""

    make: type
    decode: Callable[[Reading, dict[str, Any], str], d.AnyAnnouncement]
    encode: Callable[[Any], dict[str, Any]]
    has_writer: bool = False
    """Whether they name a DataSetWriter."""


def _required(tree: dict[str, Any], name: str) -> Any:
    value = tree.get(name)
    if value is None:
        raise RemoteWireError(JsonCause.MISSING, f"{name} is missing")
    return value


def _writer_id(reading: Reading, tree: dict[str, Any]) -> int:
    number, _ = decode_writer_id(reading, _required(tree, "DataSetWriterId"), None)
    if number is None:
        raise RemoteWireError(JsonCause.SHAPE, f"DataSetWriterId is no number: {shown(tree['DataSetWriterId'])}")
    return number


_CAPABILITIES: Final = array(TEXT)
_ENDPOINTS: Final = array(ENDPOINT_DESCRIPTION)
_TARGETS: Final = array(ACTION_TARGET)
_METHODS: Final = array(ACTION_METHOD)


def _decode_metadata(reading: Reading, tree: dict[str, Any], publisher_id: str) -> d.AnyAnnouncement:
    metadata = META_DATA.decode(reading, _required(tree, "MetaData"))
    return MetaDataAnnouncement(publisher_id, _STRING, 0, _writer_id(reading, tree), metadata)


def _decode_application(reading: Reading, tree: dict[str, Any], publisher_id: str) -> d.AnyAnnouncement:
    description = APPLICATION_DESCRIPTION.decode(reading, _required(tree, "Description"))
    capabilities = _CAPABILITIES.decode(reading, tree.get("ServerCapabilities"))
    return d.ApplicationAnnouncement(publisher_id, _STRING, 0, description, capabilities)


def _decode_endpoints(reading: Reading, tree: dict[str, Any], publisher_id: str) -> d.AnyAnnouncement:
    return d.EndpointsAnnouncement(publisher_id, _STRING, 0, _ENDPOINTS.decode(reading, tree.get("Endpoints")))


def _decode_status(reading: Reading, tree: dict[str, Any], publisher_id: str) -> d.AnyAnnouncement:
    is_cyclic = BOOLEAN.decode(reading, tree.get("IsCyclic"))
    state = ENUMERATION.decode(reading, tree.get("Status"))
    if not 0 <= state <= max(d.PubSubState):
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"Status {state} is no PubSubState")
    if not is_cyclic:
        return d.StatusAnnouncement(publisher_id, _STRING, 0, False, state)
    times = [decode_date(reading, _required(tree, name)) for name in ("NextReportTime", "Timestamp")]
    return d.StatusAnnouncement(publisher_id, _STRING, 0, True, state, *times)


def _decode_connection(make: Callable[..., d.AnyAnnouncement]) -> Callable[..., d.AnyAnnouncement]:
    def decode(reading: Reading, tree: dict[str, Any], publisher_id: str) -> d.AnyAnnouncement:
        connection = CONNECTION.decode(reading, _required(tree, "Connection"))
        return make(publisher_id, _STRING, 0, (connection,))

    return decode


def _decode_action_metadata(reading: Reading, tree: dict[str, Any], publisher_id: str) -> d.AnyAnnouncement:
    targets = _TARGETS.decode(reading, tree.get("ActionTargets"))
    request: DataSetMetaData = META_DATA.decode(reading, _required(tree, "Request"))
    reading.namespaces = request.namespaces  # the only table that the NodeIds here can refer to
    methods = _METHODS.decode(reading, tree.get("ActionMethods"))
    if methods and len(methods) != len(targets):
        raise RemoteWireError(JsonCause.SHAPE, f"{len(targets)} ActionTargets and {len(methods)} ActionMethods")
    response = META_DATA.decode(reading, _required(tree, "Response"))
    writer_id = _writer_id(reading, tree)
    return d.ActionMetaDataAnnouncement(publisher_id, _STRING, 0, writer_id, targets, request, response, methods)


def _encode_writer(writer_id: Any) -> dict[str, Any]:
    return {"DataSetWriterId": SCALAR_ENCODERS[BuiltinType.UINT16]((), False, writer_id)}


def _encode_status(value: d.StatusAnnouncement) -> dict[str, Any]:
    # IsCyclic and Status stand there even where they are false and 0: an older will has nothing else to say.
    state = SCALAR_ENCODERS[BuiltinType.INT32]((), False, value.state)
    out: dict[str, Any] = {"IsCyclic": bool(value.is_cyclic), "Status": state}
    if value.is_cyclic:
        out["NextReportTime"] = encode_date(value.next_report_time)
        out["Timestamp"] = encode_date(value.timestamp)
    return out


def _encode_connection(value: d.ConnectionsAnnouncement | d.ActionResponderAnnouncement) -> dict[str, Any]:
    if len(value.connections) != 1:
        raise LocalWireError(f"{len(value.connections)} connections: JSON has a message for each")
    return {"Connection": CONNECTION.encode((), value.connections[0])}


def _encode_action_metadata(value: d.ActionMetaDataAnnouncement) -> dict[str, Any]:
    namespaces = value.request.namespaces
    return {
        **_encode_writer(value.data_set_writer_id),
        **_present("ActionTargets", _TARGETS, namespaces, value.targets),
        "Request": META_DATA.encode((), value.request),
        "Response": META_DATA.encode((), value.response),
        **_present("ActionMethods", _METHODS, namespaces, value.methods),
    }


def _present(name: str, member: Member | Record, namespaces: tuple[str, ...], value: Any) -> dict[str, Any]:
    held = member.encode(namespaces, value)
    return {} if held is None else {name: held}


def _encode_metadata(value: MetaDataAnnouncement) -> dict[str, Any]:
    return {**_encode_writer(value.data_set_writer_id), "MetaData": META_DATA.encode((), value.metadata)}


def _encode_application(value: d.ApplicationAnnouncement) -> dict[str, Any]:
    description = APPLICATION_DESCRIPTION.encode((), value.description)
    return {"Description": description, "ServerCapabilities": list(value.capabilities)}


def _encode_endpoints(value: d.EndpointsAnnouncement) -> dict[str, Any]:
    return {"Endpoints": _ENDPOINTS.encode((), value.endpoints) or []}


ANNOUNCEMENTS: Final[dict[str, _Kind]] = {
    "ua-metadata": _Kind(MetaDataAnnouncement, _decode_metadata, _encode_metadata, has_writer=True),
    "ua-application": _Kind(d.ApplicationAnnouncement, _decode_application, _encode_application),
    "ua-endpoints": _Kind(d.EndpointsAnnouncement, _decode_endpoints, _encode_endpoints),
    "ua-status": _Kind(d.StatusAnnouncement, _decode_status, _encode_status),
    "ua-connection": _Kind(
        d.ConnectionsAnnouncement, _decode_connection(d.ConnectionsAnnouncement), _encode_connection
    ),
    "ua-action-metadata": _Kind(
        d.ActionMetaDataAnnouncement, _decode_action_metadata, _encode_action_metadata, has_writer=True
    ),
    "ua-action-responder": _Kind(
        d.ActionResponderAnnouncement, _decode_connection(d.ActionResponderAnnouncement), _encode_connection
    ),
}
"""By MessageType (table 183)."""

_TYPES: Final = {kind.make: (name, kind) for name, kind in ANNOUNCEMENTS.items()}


def decode_announcement(reading: Reading, tree: dict[str, Any]) -> JsonAnnouncement:
    """A discovery message from its parsed text; raises RemoteWireError."""
    kind = ANNOUNCEMENTS.get(tree["MessageType"])
    if kind is None:
        raise RemoteWireError(JsonCause.MESSAGE_TYPE, f"{shown(tree['MessageType'])}")
    message_id = decode_message_id(reading, tree.get("MessageId"))
    publisher_id = decode_publisher_id(reading, _required(tree, "PublisherId"))
    names: dict[str, str | None] = {
        name: None if tree.get(name) is None else decode_text(tree[name], name)
        for name in ("WriterGroupName", "DataSetWriterName")
    }
    time = tree.get("Timestamp")
    return JsonAnnouncement(
        kind.decode(reading, tree, publisher_id),
        message_id,
        None if time is None else decode_date(reading, time),
        names["WriterGroupName"],
        names["DataSetWriterName"],
        reading.leniencies,
    )


def encode_announcement(message: JsonAnnouncement) -> bytes:
    """The text of a discovery message; raises LocalWireError."""
    try:
        return _encode_announcement(message)
    except MISFITS as error:
        raise LocalWireError(f"a discovery message that is not put together right: {error}") from error


def _encode_announcement(message: JsonAnnouncement) -> bytes:
    announcement = message.announcement
    if type(announcement) not in _TYPES:
        raise LocalWireError(f"JSON has no message for {type(announcement).__name__}")
    name, kind = _TYPES[type(announcement)]
    if message.message_id is None or announcement.publisher_id is None:
        raise LocalWireError(f"a {name} message without its MessageId or PublisherId")
    out: dict[str, Any] = {
        "MessageId": message.message_id,
        "MessageType": name,
        "PublisherId": encode_publisher_id(announcement.publisher_id),
    }
    if message.timestamp is not None and name != "ua-status":  # whose announcement has its own
        out["Timestamp"] = encode_date(message.timestamp)
    if kind.has_writer:
        if message.writer_group_name is not None:
            out["WriterGroupName"] = message.writer_group_name
        if message.data_set_writer_name is not None:
            out["DataSetWriterName"] = message.data_set_writer_name
    return dump(out | kind.encode(announcement))
