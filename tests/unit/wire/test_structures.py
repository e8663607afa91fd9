"""The structures of discovery: byte for byte what asyncua encodes, and what they refuse."""

from __future__ import annotations

from typing import Any

import pytest
from asyncua import ua as typed_ua
from asyncua.ua.ua_binary import struct_to_binary

from tests.unit.wire import asyncua_structures as theirs_of
from tests.unit.wire.corpus import MINIMAL_METADATA
from tests.unit.wire.discovery_samples import (
    APPLICATION,
    CONNECTION_OF_ALL,
    ENDPOINT,
    GROUP,
    METHOD,
    PLAIN_CONNECTION,
    TARGET,
    VENDOR_SETTINGS,
)
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ExtensionObject, NodeId
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.configuration import (
    ACTION_METHOD,
    ACTION_TARGET,
    ADDRESS,
    APPLICATION_DESCRIPTION,
    CONNECTION,
    ENDPOINT_DESCRIPTION,
    META_DATA,
    WRITER_GROUP,
)
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.discovered import NetworkAddressUrl, WriterConfigurationAnnouncement, WriterGroup
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.structure import Shape

ua: Any = typed_ua
"""Its integer types are not ours."""

SAME: list[tuple[Shape, Any, Any]] = [
    (APPLICATION_DESCRIPTION, APPLICATION, theirs_of.application(APPLICATION)),
    (ENDPOINT_DESCRIPTION, ENDPOINT, theirs_of.endpoint(ENDPOINT)),
    (META_DATA, MINIMAL_METADATA, theirs_of.metadata(MINIMAL_METADATA)),
    (WRITER_GROUP, GROUP, theirs_of.writer_group(GROUP)),
    (WRITER_GROUP, WriterGroup(None, False), theirs_of.writer_group(WriterGroup(None, False))),
    (CONNECTION, PLAIN_CONNECTION, theirs_of.connection(PLAIN_CONNECTION)),
    (CONNECTION, CONNECTION_OF_ALL, theirs_of.connection(CONNECTION_OF_ALL)),
    (ACTION_TARGET, TARGET, ua.ActionTargetDataType(3, "gripper", theirs_of.text(TARGET.description))),
    (ACTION_METHOD, METHOD, ua.ActionMethodDataType(ua.NodeId("robot", 2), ua.NodeId(9, 2))),
]


@pytest.mark.parametrize(("shape", "ours", "theirs"), SAME)
def test_asyncua_encodes_the_same(shape: Shape, ours: Any, theirs: Any) -> None:
    out = bytearray()
    shape.encode(out, ours)
    assert out.hex() == struct_to_binary(theirs).hex()
    assert shape.decode(Cursor(bytes(out))) == ours
    assert shape.smallest <= len(out)


def encoded(shape: Shape, value: Any) -> bytes:
    out = bytearray()
    shape.encode(out, value)
    return bytes(out)


def test_what_is_not_known_stays_an_extension_object() -> None:
    xml = ExtensionObject(NodeId(0, 21152), "<NetworkAddressUrlDataType/>")
    for value in (VENDOR_SETTINGS, xml, ExtensionObject(NodeId(0, 15693), b""), ExtensionObject(NodeId(2, "a"), None)):
        assert ADDRESS.decode(Cursor(encoded(ADDRESS, value))) == value
    assert ADDRESS.decode(Cursor(encoded(ADDRESS, None))) is None


def test_a_known_structure_fills_its_extension_object() -> None:
    data = encoded(ADDRESS, NetworkAddressUrl("lo", "opc.udp://a"))
    for size, cause in ((-1, "length_beyond_end"), (1, "trailing_bytes")):
        body = data[9:] + b"x" if size > 0 else data[9:-1]
        wrong = encoded(ADDRESS, ExtensionObject(NodeId(0, 21152), body))
        with pytest.raises(RemoteWireError) as caught:
            ADDRESS.decode(Cursor(wrong))
        assert caught.value.cause == cause


@pytest.mark.parametrize(
    "wrong",
    [
        GROUP._replace(data_set_writers=(ENDPOINT,)),  # type: ignore[arg-type]
        GROUP._replace(data_set_writers=None),  # type: ignore[arg-type]
        GROUP._replace(writer_group_id=70_000),
        GROUP._replace(enabled=1),  # type: ignore[arg-type]
        GROUP._replace(name=5),  # type: ignore[arg-type]
        GROUP._replace(message_settings=b"bytes"),  # type: ignore[arg-type]
        (1, 2),
        None,
    ],
)
def test_what_cannot_be_sent(wrong: Any) -> None:
    announcement = WriterConfigurationAnnouncement(7, PublisherIdType.UINT16, 0, (), wrong, ())
    with pytest.raises(LocalWireError):
        encode_announcement(announcement)
