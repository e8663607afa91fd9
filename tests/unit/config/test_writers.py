"""What `fleet.yaml` says of DataSetWriters: their encoding, their key frames, their events, their PublisherIds."""

from __future__ import annotations

import json
from typing import Any

import pytest

from ua_fleet.config.applications import bridge_application
from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import events_topic, writer_settings
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import publisher_ids
from ua_fleet.errors import ConfigInvalid
from ua_fleet.pubsub.layout import WriterSettings
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, Variant
from ua_fleet.wire.messages import FieldEncoding, PublisherIdType

DATA = {
    "plain": {"id": 1001, "type": "Double"},
    "raw": {"id": 1002, "type": "Double", "encoding": "raw_data"},
    "delta": {"id": 1003, "fields": {"x": {"type": "Double"}}, "key_frame_count": 10},
    "told": {"id": 1004, "type": "Double", "origin": "server", "encoding": "raw_data", "key_frame_count": 2},
}


def fleet(bridges: dict[str, Any] | None = None, **more: Any) -> FleetConfig:
    document: dict[str, Any] = {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": bridges or {"floor": {"kind": "ros2", "space": 2, "status_id": 1900}},
        "robots": {"carrier": {"bridge": "floor", "data": DATA}},
        **more,
    }
    return load_content(json.dumps(document).encode(), "f.yaml", {})


def problems(bridges: dict[str, Any] | None = None, **more: Any) -> list[tuple[str, str]]:
    with pytest.raises(ConfigInvalid) as caught:
        fleet(bridges, **more)
    return [(problem.key or "", problem.message) for problem in caught.value.problems]


def test_each_source_by_its_topic() -> None:
    config = fleet(scenarios={"events_id": 1990})
    raw = FieldEncoding.RAW_DATA
    assert writer_settings(config) == {
        Topic(2, 2, 1002): WriterSettings(raw),
        Topic(2, 2, 1003): WriterSettings(key_frame_count=10),
        Topic(0, 2, 1004): WriterSettings(raw, 2),
        Topic(0, 2, 1990): WriterSettings(are_events=True),
    }
    assert events_topic(fleet()) is None


def test_the_id_of_events_is_no_other_s() -> None:
    [(key, text)] = problems(scenarios={"events_id": 1003})
    assert key == "scenarios.events_id"
    assert "1003 is in use already (robots.carrier.data.delta.id" in text


BRIDGE = {"kind": "ros2", "space": 2, "status_id": 1900}
OTHER = {"kind": "ros2", "space": 3, "status_id": 1901}


@pytest.mark.parametrize(
    ("publisher_id", "kind", "wire"),
    [
        (7, "Byte", (PublisherIdType.BYTE, 7)),
        (40_000, None, (PublisherIdType.UINT16, 40_000)),
        (7, "UInt32", (PublisherIdType.UINT32, 7)),
        (1 << 50, "UInt64", (PublisherIdType.UINT64, 1 << 50)),
        ("press-7", None, (PublisherIdType.STRING, "press-7")),
    ],
)
def test_a_publisher_id_of_each_type(publisher_id: int | str, kind: str | None, wire: tuple[int, int | str]) -> None:
    typed = {} if kind is None else {"publisher_id_type": kind}
    config = fleet({"floor": {**BRIDGE, "publisher_id": publisher_id, **typed}})
    ids = publisher_ids(config)
    assert ids is not None
    builtin = {0: BuiltinType.BYTE, 1: BuiltinType.UINT16, 2: BuiltinType.UINT32, 3: BuiltinType.UINT64}
    assert ids.variant(2) == Variant(int(builtin.get(wire[0], BuiltinType.STRING)), wire[1])
    assert bridge_application(config, "floor").publisher_id == ids.variant(2)
    assert publisher_ids(fleet()) is None


SOURCE = {
    "oven": {"publisher_id": "press-7", "data_set_writer_id": 1, "robot": "carrier", "data": "plain"},
}


@pytest.mark.parametrize(
    ("bridges", "more", "expected"),
    [
        ({"publisher_id": 3}, {}, "it is the PublisherId of bridge `other`, whose space it is"),
        ({"publisher_id": 0}, {}, "it is the PublisherId of the server"),
        ({"publisher_id": "press-7"}, {"sources": SOURCE}, "it is the PublisherId of `sources.oven`"),
        ({"publisher_id": 300, "publisher_id_type": "Byte"}, {}, "a Byte is 0 to 255"),
        ({"publisher_id": "x", "publisher_id_type": "UInt16"}, {}, "'x' is no UInt16"),
        ({"publisher_id_type": "UInt16"}, {}, "give `publisher_id` too"),
    ],
)
def test_a_publisher_id_that_cannot_be(bridges: dict[str, Any], more: dict[str, Any], expected: str) -> None:
    [(key, text)] = problems({"floor": {**BRIDGE, **bridges}, "other": OTHER}, **more)
    assert key.startswith("bridges.floor")
    assert expected in text


def test_two_bridges_have_two_names() -> None:
    [(key, text)] = problems({"floor": {**BRIDGE, "publisher_id": "a"}, "other": {**OTHER, "publisher_id": "a"}})
    assert (key, text) == ("bridges.other.publisher_id", "it is the PublisherId of bridge `floor`")


def test_its_own_space_is_no_other_name() -> None:
    ids = publisher_ids(fleet({"floor": {**BRIDGE, "publisher_id": 2}}))
    assert ids is not None
    assert ids.outward(b"\xf1\x01\x02\x00\x01") == b"\xf1\x01\x02\x00\x01"
