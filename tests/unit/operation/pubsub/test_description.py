"""What the Objects of PubSub's information model say, from the structures of configuration."""

from __future__ import annotations

import uuid
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.operation.pubsub.description import (
    Counter,
    Diagnostics,
    Live,
    Shown,
    describe_connection,
    describe_data_set,
    describe_reader,
    describe_writer,
    describe_writer_group,
)
from ua_fleet.operation.pubsub.difference import Part, difference
from ua_fleet.operation.pubsub.structures import field_target, metadata_value, published_variable, version_value
from ua_fleet.pubsub import make_field
from ua_fleet.values import BuiltinType, NodeId, StatusCode, Variant
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.discovered import (
    DatagramConnectionTransport,
    DataSetReader,
    DataSetWriter,
    NetworkAddressUrl,
    PubSubConnection,
    UadpDataSetWriterMessage,
    UadpWriterGroupMessage,
    WriterGroup,
)
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData
from ua_fleet.wire.metadata import decode_metadata

OPERATIONAL = Live.plain(lambda: 2)
METADATA = DataSetMetaData("arm", (make_field("level", BuiltinType.DOUBLE),), ConfigurationVersion(7, 8))
ADDRESS = NetworkAddressUrl("lo", "opc.udp://239.0.0.1:4840")


def test_a_connection_says_where_its_messages_go() -> None:
    transport = DatagramConnectionTransport(ADDRESS, 5)
    made = PubSubConnection(
        "a", True, Variant(int(BuiltinType.UINT16), 3), "profile", ADDRESS, transport_settings=transport
    )
    described = describe_connection(made, OPERATIONAL, None, can_switch=True)
    assert described.type == "PubSubConnectionType"
    assert described.values["PublisherId"] == Variant(int(BuiltinType.UINT16), 3)
    assert described.values["TransportProfileUri.Selections"] == ["profile"]
    assert described.values["Address.Url"] == described.values["TransportSettings.DiscoveryAddress.Url"] == ADDRESS.url
    assert described.kinds["TransportSettings"] == "DatagramConnectionTransportType"
    assert described.methods == {"Status.Enable", "Status.Disable"}
    over_a_broker = describe_connection(made._replace(transport_settings=None), OPERATIONAL, None, can_switch=False)
    assert not [way for way in over_a_broker.values if way.startswith("TransportSettings")]
    assert over_a_broker.methods == frozenset()


def test_what_a_group_is_not_told_of_is_absent() -> None:
    group = WriterGroup("g", True, writer_group_id=2, message_settings=UadpWriterGroupMessage(3))
    described = describe_writer_group(group, OPERATIONAL, None, can_switch=True)
    assert "SecurityGroupId" not in described.values
    assert described.values["MessageSettings.GroupVersion"] == 3
    secured = describe_writer_group(
        group._replace(security_group_id="t-1", message_settings=None), OPERATIONAL, None, can_switch=True
    )
    assert secured.values["SecurityGroupId"] == "t-1"
    assert "MessageSettings" not in secured.kinds
    assert not [way for way in secured.values if way.startswith("Diagnostics")]


def test_a_writer_and_its_data_set_say_what_is_sent() -> None:
    writer = DataSetWriter("w", True, 1001, 0x20, 3, message_settings=UadpDataSetWriterMessage(0x3D))
    values = describe_writer(writer, OPERATIONAL, None, can_switch=True).values
    assert (values["DataSetWriterId"], values["DataSetFieldContentMask"], values["KeyFrameCount"]) == (1001, 0x20, 3)
    assert values["MessageSettings.DataSetMessageContentMask"] == 0x3D
    of_variables = describe_data_set(lambda: METADATA, lambda: [NodeId(2, 1001)])
    assert of_variables.type == "PublishedDataItemsType"
    assert of_variables.values["PublishedData"].now().value == [published_variable(NodeId(2, 1001))]
    assert describe_data_set(lambda: METADATA, None).type == "PublishedDataSetType"
    shown = of_variables.values["DataSetMetaData"].now().value
    assert decode_metadata(Cursor(shown.body)) == METADATA
    assert of_variables.values["ConfigurationVersion"].now().value == version_value(ConfigurationVersion(7, 8))
    assert version_value(ConfigurationVersion(7, 8)).body == b"\x07\0\0\0\x08\0\0\0"
    assert metadata_value(METADATA).type_id == NodeId(0, 124)


def test_a_reader_says_where_its_values_go_as_they_are_known() -> None:
    known: list[tuple[uuid.UUID, NodeId]] = []
    reader = DataSetReader("r", True, Variant(5, 3), 2, 1001, METADATA, message_receive_timeout_ms=800.0)
    described = describe_reader(reader, lambda: METADATA, lambda: known, OPERATIONAL, None)
    targets = described.values["SubscribedDataSet.TargetVariables"]
    assert targets.now() == Shown([])
    known.append((uuid.UUID(int=1), NodeId(2, 1001)))
    assert targets.now().value == [field_target(uuid.UUID(int=1), NodeId(2, 1001))]
    assert described.kinds["SubscribedDataSet"] == "TargetVariablesType"


def test_a_live_value_may_say_that_it_is_not_good() -> None:
    unknown = Shown(None, int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA))
    assert Live.plain(lambda: unknown).now() == unknown
    assert Live.plain(lambda: 3).now() == Shown(3, 0)


@given(counts=st.dictionaries(st.text("abc", min_size=1), st.tuples(st.integers(0, 2**33), st.booleans()), max_size=6))
def test_totals_are_the_sums_of_the_counters_and_stop_at_the_largest(counts: dict[str, tuple[int, bool]]) -> None:
    def counted(count: int) -> Any:
        return lambda: count

    diagnostics = Diagnostics({name: Counter(counted(count), errors) for name, (count, errors) in counts.items()})
    values = diagnostics.values()
    for name, errors in (("TotalInformation", False), ("TotalError", True)):
        total = sum(count for count, is_error in counts.values() if is_error is errors)
        assert values[f"Diagnostics.{name}"].now().value == min(total, 0xFFFF_FFFF)
        assert values[f"Diagnostics.{name}.Classification"] == int(errors)
    for name, (count, errors) in counts.items():
        assert values[f"Diagnostics.Counters.{name}"].now().value == min(count, 0xFFFF_FFFF)
        assert values[f"Diagnostics.Counters.{name}.Classification"] == int(errors)


PARTS = st.dictionaries(st.integers(0, 8), st.builds(Part, st.sampled_from("ab"), st.integers(0, 2)))


@given(before=PARTS, after=PARTS)
def test_a_difference_makes_of_one_set_the_other(before: dict[int, Part], after: dict[int, Part]) -> None:
    gone, new = difference(before, after)
    made = {key: part for key, part in before.items() if key not in gone}
    assert not made.keys() & set(new)
    assert made | {key: after[key] for key in new} == after
    assert all(before[key] != after.get(key) for key in gone)  # what has not changed stays
