"""Metadata, status and the other discovery messages as JSON, with names and numbers of a second implementation."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import orjson
import pytest
from asyncua import ua as typed_ua

from tests.unit.wire import discovery_samples
from tests.unit.wire.corpus import FULL_METADATA
from tests.unit.wire.json.samples import METADATA, NOON
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ExtensionObject
from ua_fleet.wire import discovered as d
from ua_fleet.wire.discovery_structures import Forms, make_structures
from ua_fleet.wire.json import JsonAnnouncement, JsonBody, JsonCause, Leniency, decode_json, metadata
from ua_fleet.wire.json import encode_announcement as encode
from ua_fleet.wire.messages import MetaDataAnnouncement, PublisherIdType

ua: Any = typed_ua
STRING = PublisherIdType.STRING.value

CONNECTION = discovery_samples.CONNECTION_OF_ALL
ANNOUNCEMENTS: list[d.AnyAnnouncement] = [
    MetaDataAnnouncement("2", STRING, 0, 1001, METADATA),
    MetaDataAnnouncement("2", STRING, 0, 1001, FULL_METADATA),
    d.ApplicationAnnouncement(
        "2", STRING, 0, d.ApplicationDescription("urn:app", discovery_urls=("opc.tcp://x",)), ("DA",)
    ),
    d.EndpointsAnnouncement("2", STRING, 0, (discovery_samples.ENDPOINT,) * 2),
    d.StatusAnnouncement("2", STRING, 0, False, d.PubSubState.ERROR),
    d.StatusAnnouncement("2", STRING, 0, True, d.PubSubState.OPERATIONAL, NOON + 1, NOON),
    d.ConnectionsAnnouncement("2", STRING, 0, (CONNECTION,)),
    d.ActionMetaDataAnnouncement(
        "2",
        STRING,
        0,
        1001,
        (discovery_samples.TARGET,),
        METADATA,
        METADATA._replace(fields=()),
        (discovery_samples.METHOD,),
    ),
    d.ActionResponderAnnouncement("2", STRING, 0, (CONNECTION,)),
]


@pytest.mark.parametrize("announcement", ANNOUNCEMENTS, ids=lambda value: type(value).__name__)
def test_both_ways(announcement: d.AnyAnnouncement) -> None:
    has_writer = isinstance(announcement, MetaDataAnnouncement | d.ActionMetaDataAnnouncement)
    names = ("group", "writer") if has_writer else (None, None)
    time = announcement.timestamp if isinstance(announcement, d.StatusAnnouncement) else NOON
    message = JsonAnnouncement(announcement, "m-1", time, *names)
    back = decode_json(encode(message))
    assert back == message._replace(leniencies={})


def test_a_status_as_text() -> None:
    """As a last will has it (OPC 10000-14 7.2.5.5.5): no times, and IsCyclic false."""
    will = JsonAnnouncement(d.StatusAnnouncement(2, PublisherIdType.UINT16, 0, False, d.PubSubState.ERROR), "w-1")
    assert json.loads(encode(will)) == {
        "MessageId": "w-1",
        "MessageType": "ua-status",
        "PublisherId": "2",
        "IsCyclic": False,
        "Status": 3,
    }


def test_metadata_as_the_annex_has_it() -> None:
    """Member names of the example in OPC 10000-14 A.3.1; null and default members are left out."""
    text = orjson.dumps(
        {
            "MessageId": "66D65CA4-92EE-4195-9867-E6E27794B692",
            "MessageType": "ua-metadata",
            "PublisherId": "MyPublisher",
            "DataSetWriterId": 101,
            "MetaData": {
                "Name": "DataSet1",
                "Fields": [
                    {
                        "Name": "Active",
                        "FieldFlags": 0,
                        "BuiltInType": 1,
                        "DataType": "i=1",
                        "ValueRank": -1,
                        "MaxStringLength": 0,
                        "DataSetFieldId": "6a8f2b3a-0000-4000-8000-000000000001",
                    }
                ],
                "ConfigurationVersion": {"MajorVersion": 672338910, "MinorVersion": 672341762},
            },
        }
    )
    back = decode_json(text)
    assert isinstance(back, JsonAnnouncement)
    assert isinstance(back.announcement, MetaDataAnnouncement)
    (field,) = back.announcement.metadata.fields
    assert (field.name, field.builtin_type, field.value_rank, field.data_type) == ("Active", 1, -1, None)
    assert back.announcement.metadata.configuration_version == (672338910, 672341762)


def test_a_structure_of_a_broker_stays_json() -> None:
    settings = {"UaTypeId": "i=15669", "QueueName": "ua_2_2_1001", "RequestedDeliveryGuarantee": 2}
    writer = {"Name": "w", "Enabled": True, "DataSetWriterId": 1, "TransportSettings": settings}
    connection = {"Name": "c", "WriterGroups": [{"Name": "g", "DataSetWriters": [writer]}]}
    tree = {"MessageId": "1", "MessageType": "ua-connection", "PublisherId": "2", "Connection": connection}
    back = decode_json(orjson.dumps(tree))
    assert isinstance(back, JsonAnnouncement)
    assert isinstance(back.announcement, d.ConnectionsAnnouncement)
    (group,) = back.announcement.connections[0].writer_groups
    kept = group.data_set_writers[0].transport_settings
    assert isinstance(kept, ExtensionObject)
    assert isinstance(kept.body, JsonBody)
    assert set(back.leniencies) == {Leniency.STRUCTURE_UNDESCRIBED}
    assert json.loads(encode(back)) == tree


def structures_of_discovery() -> list[tuple[list[str], str]]:
    """Names of their members, whatever the encoding, and of their DataTypes."""
    found: list[tuple[list[str], str]] = []

    def structure(kind: type, **members: None) -> None:
        name = "DatagramConnectionTransport2" if kind is d.DatagramConnectionTransport else kind.__name__
        found.append((list(members), name if hasattr(ua, name) else f"{name}DataType"))

    def nothing(*_: object) -> None:
        return

    makers = {"structure": structure, "array": nothing, "extension": nothing}
    forms = Forms[None]._make([makers.get(name) for name in Forms._fields])
    make_structures(forms)
    return found


NAMES: list[tuple[list[str], str]] = structures_of_discovery() + [
    (list(record.names), name)
    for record, name in (
        (metadata.FIELD, "FieldMetaData"),
        (metadata.STRUCTURE_FIELD, "StructureField"),
        (metadata.STRUCTURE_DEFINITION, "StructureDefinition"),
        (metadata.ENUMERATION_DEFINITION, "EnumDefinition"),
        (metadata.STRUCTURE_DESCRIPTION, "StructureDescription"),
        (metadata.ENUMERATION_FIELD, "EnumField"),
        (metadata.ENUMERATION_DESCRIPTION, "EnumDescription"),
        (metadata.SIMPLE_TYPE_DESCRIPTION, "SimpleTypeDescription"),
        (metadata.VERSION, "ConfigurationVersionDataType"),
        (metadata.DATA_SET_META_DATA, "DataSetMetaDataType"),
    )
]


@pytest.mark.parametrize(("names", "data_type"), NAMES, ids=[name for _, name in NAMES])
def test_names_of_members_are_those_of_the_data_types(names: list[str], data_type: str) -> None:
    """asyncua generates its classes from the DataTypes of the specification."""
    assert names == [field.name for field in dataclasses.fields(getattr(ua, data_type))]


WRONG: list[tuple[dict[str, Any], JsonCause]] = [
    ({"PublisherId": None}, JsonCause.MISSING),
    ({"MetaData": None}, JsonCause.MISSING),
    ({"MetaData": []}, JsonCause.SHAPE),
    ({"DataSetWriterId": None}, JsonCause.MISSING),
    ({"DataSetWriterId": "arm"}, JsonCause.SHAPE),
    ({"Timestamp": 5}, JsonCause.VALUE_TYPE),
    ({"WriterGroupName": 5}, JsonCause.SHAPE),
    ({"MetaData": {"Fields": {}}}, JsonCause.SHAPE),
    ({"MetaData": {"Fields": [5]}}, JsonCause.SHAPE),
    ({"MetaData": {"Fields": [{"BuiltInType": 256}]}}, JsonCause.VALUE_RANGE),
    ({"MetaData": {"Fields": [{}] * 2001}}, JsonCause.ELEMENTS),
    ({"MetaData": {"Namespaces": [f"urn:{index}" for index in range(257)]}}, JsonCause.ELEMENTS),
    ({"MetaData": {"EnumDataTypes": [{"EnumDefinition": {"Fields": [{}] * 2000}}]}}, JsonCause.ELEMENTS),
    ({"MetaData": {"StructureDataTypes": [{"StructureDefinition": {"Fields": [{}] * 2000}}]}}, JsonCause.ELEMENTS),
    ({"MetaData": {"Fields": [{"Properties": [{}] * 2000}]}}, JsonCause.ELEMENTS),
    ({"MessageType": "ua-status", "IsCyclic": True, "Status": 2}, JsonCause.MISSING),
    ({"MessageType": "ua-status", "Status": 5}, JsonCause.VALUE_RANGE),
    ({"MessageType": "ua-connection"}, JsonCause.MISSING),
    ({"MessageType": "ua-action-metadata", "ActionMethods": [{}], "Request": {}}, JsonCause.SHAPE),
]


@pytest.mark.parametrize(("change", "cause"), WRONG)
def test_what_is_refused(change: dict[str, Any], cause: JsonCause) -> None:
    tree: dict[str, Any] = {
        "MessageId": "1",
        "MessageType": "ua-metadata",
        "PublisherId": "2",
        "DataSetWriterId": 1,
        "MetaData": {},
    }
    with pytest.raises(RemoteWireError) as caught:
        decode_json(orjson.dumps(tree | change))
    assert caught.value.cause == cause


def test_our_own_mistakes_are_local() -> None:
    status = d.StatusAnnouncement("2", STRING, 0, False, 3)
    with pytest.raises(LocalWireError):
        encode(JsonAnnouncement(status))
    with pytest.raises(LocalWireError):
        encode(JsonAnnouncement(d.ConnectionsAnnouncement("2", STRING, 0, ()), "1"))
    with pytest.raises(LocalWireError):
        encode(
            JsonAnnouncement(d.WriterConfigurationAnnouncement("2", STRING, 0, (), d.WriterGroup("g", True), ()), "1")
        )
