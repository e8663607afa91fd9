"""Whatever robots and strangers send, the state goes on and each node has one owner."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.fleet.fleet_of import Fleet, message
from ua_fleet.config.schema import UnknownSources
from ua_fleet.fleet import SourceAdded, SourceRemoved, ValueChanged
from ua_fleet.pubsub.events import DataReceived, MetaDataReceived, SourceReturned, SourceSilent, SubscriberEvent
from ua_fleet.pubsub.metadata import make_field, type_code
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData

SCALARS: dict[int, st.SearchStrategy[Any]] = {
    BuiltinType.BOOLEAN: st.booleans(),
    BuiltinType.INT32: st.integers(-5, 5),
    BuiltinType.DOUBLE: st.floats(),
    BuiltinType.STRING: st.none() | st.text(max_size=3),
    BuiltinType.BYTE_STRING: st.none() | st.binary(max_size=3),
    BuiltinType.STATUS_CODE: st.sampled_from([0, 0x80310000, 0x40000000]),
}
topics = st.builds(
    Topic, st.sampled_from([2, 3, 7]), st.sampled_from([2, 2, 2, 3]), st.sampled_from([1001, 1003, 1004, 1900, 7])
)
names = st.sampled_from(["x", "frame", "data", "Topic", "", "Connected"])


@st.composite
def metadata(draw: st.DrawFn) -> DataSetMetaData:
    fields = tuple(
        make_field(draw(names), draw(st.sampled_from(list(SCALARS))), array=draw(st.booleans()))
        for _ in range(draw(st.integers(0, 3)))
    )
    version = draw(st.integers(1, 3))
    return DataSetMetaData(draw(names), fields, ConfigurationVersion(version, version))


@st.composite
def events(draw: st.DrawFn) -> SubscriberEvent:
    topic = draw(topics)
    kind = draw(st.integers(0, 5))
    if kind == 0:
        return SourceSilent(topic)
    if kind == 1:
        return SourceReturned(topic)
    layout = draw(metadata())
    if kind == 2:
        return MetaDataReceived(topic, layout)
    types: list[int] = []
    contents: list[Any] = []
    for field in layout.fields:
        code = draw(st.sampled_from([type_code(field), type_code(field), int(BuiltinType.STATUS_CODE)]))
        scalar = SCALARS[code & 0x3F]
        types.append(code)
        contents.append(draw(st.none() | st.lists(scalar, max_size=2).map(tuple)) if code & ARRAY else draw(scalar))
    status = draw(st.sampled_from([None, 0, 0x80310000, 0x80740000]))
    stamp = draw(st.none() | st.integers(0, 9))
    more: dict[str, Any] = {}
    if draw(st.booleans()):
        more["field_status"] = tuple(draw(st.sampled_from([0, 0x808C0000])) for _ in types)
    return DataReceived(topic, message(types, contents, stamp, status, **more), layout)


@settings(max_examples=150)
@given(st.lists(events(), max_size=25), st.sampled_from(UnknownSources))
def test_any_traffic(traffic: list[SubscriberEvent], policy: UnknownSources) -> None:
    fleet = Fleet(policy, max_sources=2)
    nodes = {field.key for data_set in fleet.model.data_sets() for field in data_set.fields}
    owners: dict[NodeId, Topic] = {}
    for number, event in enumerate(traffic):
        for change in fleet.state.apply(event, number):
            if isinstance(change, SourceAdded):
                for field in change.data_set.fields:
                    assert field.key not in nodes
                    nodes.add(field.key)
                    owners[field.key] = change.data_set.topic
            elif isinstance(change, SourceRemoved):
                nodes -= {field.key for field in change.data_set.fields}
            elif isinstance(change, ValueChanged) and isinstance(event, DataReceived):
                if str(change.key.identifier).startswith("Robots.") or change.key.identifier == "1900.Online":
                    continue
                assert change.key in nodes
                assert owners.get(change.key, event.topic) == event.topic
                assert event.topic.space == 2 or change.key in owners
        fleet.state.tick(number)
