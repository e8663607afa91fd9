"""What a node of the information model of PubSub says: pure descriptions from the structures of configuration.

A description names an ObjectType of the standard, and the values of its members by their way below the Object, e.g.
`Status.State`. Mandatory members are there in any case, optional ones where a value, a kind or a Method is given for
them. A value is a plain one, or computed when it is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from ua_fleet.operation.pubsub.structures import (
    field_target,
    key_value_pairs,
    metadata_value,
    published_variable,
    version_value,
)
from ua_fleet.values import NodeId
from ua_fleet.wire.discovered import (
    DatagramConnectionTransport,
    DataSetReader,
    DataSetWriter,
    JsonDataSetWriterMessage,
    JsonWriterGroupMessage,
    NetworkAddressUrl,
    PubSubConnection,
    UadpDataSetWriterMessage,
    UadpWriterGroupMessage,
    WriterGroup,
)
from ua_fleet.wire.messages import DataSetMetaData

__all__ = [
    "Counter",
    "Description",
    "Diagnostics",
    "Live",
    "Shown",
    "describe_connection",
    "describe_data_set",
    "describe_reader",
    "describe_reader_group",
    "describe_writer",
    "describe_writer_group",
    "small_counts",
]

BASIC: Final = 0
ADVANCED: Final = 1
"""DiagnosticsLevels (9.1.11.4)."""
ERROR: Final = 1
"""PubSubDiagnosticsCounterClassification; 0 is Information (9.1.11.6)."""
LARGEST: Final = 0xFFFF_FFFF
"""Where a counter stops (9.1.11.5)."""
_MOST_UINT16: Final = 0xFFFF


class Shown(NamedTuple):
    """A value with its StatusCode."""

    value: Any
    status: int = 0


@dataclass(frozen=True, slots=True)
class Live:
    """A value that is computed when it is read."""

    now: Callable[[], Shown]

    @classmethod
    def plain(cls, compute: Callable[[], Any]) -> Live:
        """One that is Good, unless what is computed is Shown with another status."""

        def now() -> Shown:
            value = compute()
            return value if isinstance(value, Shown) else Shown(value)

        return cls(now)


@dataclass(frozen=True, slots=True)
class Description:
    """One Object."""

    type: str
    """Name of its ObjectType in the base namespace."""
    values: Mapping[str, Any]
    kinds: Mapping[str, str] = field(default_factory=dict[str, str])
    """Types of members whose declared type is abstract."""
    methods: frozenset[str] = frozenset()
    """Optional Methods that it has."""


@dataclass(frozen=True, slots=True)
class Counter:
    """A counter of a Diagnostics Object."""

    count: Callable[[], int]
    is_error: bool = False
    level: int = BASIC


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What a Diagnostics Object shows."""

    counters: Mapping[str, Counter]
    live: Mapping[str, Callable[[], Any]] = field(default_factory=dict[str, Callable[[], Any]])
    sub_error: Callable[[], bool] = lambda: False
    """Whether an Object of the next layer has counted an error."""
    status: Callable[[], int] = lambda: 0
    """StatusCode of all that is counted; not Good where it is not of now."""

    def total(self, *, errors: bool) -> int:
        """The sum of the counters of errors, or of the others."""
        return min(sum(each.count() for each in self.counters.values() if each.is_error is errors), LARGEST)

    def values(self, way: str = "Diagnostics.") -> dict[str, Any]:
        """The values of its members."""
        level = max((each.level for each in self.counters.values()), default=BASIC)
        counters = {
            f"{way}TotalInformation": Counter(lambda: self.total(errors=False)),
            f"{way}TotalError": Counter(lambda: self.total(errors=True), is_error=True),
            **{f"{way}Counters.{name}": each for name, each in self.counters.items()},
        }
        values: dict[str, Any] = {f"{way}DiagnosticsLevel": level, f"{way}SubError": self._live(self.sub_error)}
        for name, each in counters.items():
            values[name] = self._live(_stopping(each.count))
            values[f"{name}.Active"] = True
            values[f"{name}.Classification"] = int(each.is_error)
            values[f"{name}.DiagnosticsLevel"] = each.level
        for name, compute in self.live.items():
            values[f"{way}LiveValues.{name}"] = self._live(compute)
        return values

    def _live(self, compute: Callable[[], Any]) -> Live:
        def now() -> Shown:
            value, status = compute(), self.status()
            return value if isinstance(value, Shown) else Shown(value, status)

        return Live(now)


def _stopping(count: Callable[[], int]) -> Callable[[], int]:
    return lambda: min(count(), LARGEST)


def _small(count: int) -> int:
    return min(count, _MOST_UINT16)


_SWITCHES: Final = frozenset({"Status.Enable", "Status.Disable"})


def _described(
    type_name: str,
    values: Mapping[str, Any],
    kinds: Mapping[str, str],
    state: Live,
    diagnostics: Diagnostics | None,
    *,
    can_switch: bool,
) -> Description:
    """An Object with its Status, and with its Diagnostics where these are known."""
    all_values = {**values, "Status.State": state}
    if diagnostics is not None:
        all_values |= diagnostics.values()
    return Description(type_name, all_values, kinds, _SWITCHES if can_switch else frozenset())


def describe_connection(
    connection: PubSubConnection, state: Live, diagnostics: Diagnostics | None, *, can_switch: bool
) -> Description:
    """A PubSubConnection (9.1.5.2), without what is below it."""
    profile = connection.transport_profile_uri or ""
    values: dict[str, Any] = {
        "PublisherId": connection.publisher_id,
        "TransportProfileUri": profile,
        "TransportProfileUri.Selections": [profile],
        "ConnectionProperties": key_value_pairs(connection.properties),
        **_address("Address", connection.address),
    }
    kinds = {"Address": "NetworkAddressUrlType"}
    if isinstance(settings := connection.transport_settings, DatagramConnectionTransport):
        kinds["TransportSettings"] = "DatagramConnectionTransportType"
        kinds["TransportSettings.DiscoveryAddress"] = "NetworkAddressUrlType"
        values |= _address("TransportSettings.DiscoveryAddress", settings.discovery_address)
        values["TransportSettings.DiscoveryAnnounceRate"] = settings.discovery_announce_rate
        values["TransportSettings.DiscoveryMaxMessageSize"] = settings.discovery_max_message_size
    return _described("PubSubConnectionType", values, kinds, state, diagnostics, can_switch=can_switch)


def _address(way: str, address: Any) -> dict[str, Any]:
    known = address if isinstance(address, NetworkAddressUrl) else NetworkAddressUrl(None, None)
    interface = known.network_interface or ""
    return {
        f"{way}.NetworkInterface": interface,
        f"{way}.NetworkInterface.Selections": [interface],
        f"{way}.Url": known.url or "",
    }


def describe_writer_group(
    group: WriterGroup, state: Live, diagnostics: Diagnostics | None, *, can_switch: bool
) -> Description:
    """A WriterGroup (9.1.6.3), without its DataSetWriters."""
    values: dict[str, Any] = {
        **_group(group.security_mode, group.security_group_id, group.max_network_message_size, group.properties),
        "WriterGroupId": group.writer_group_id,
        "PublishingInterval": group.publishing_interval_ms,
        "KeepAliveTime": group.keep_alive_time_ms,
        "Priority": group.priority,
        "LocaleIds": list(group.locale_ids),
        "HeaderLayoutUri": group.header_layout_uri or "",
    }
    kinds: dict[str, str] = {}
    if isinstance(settings := group.message_settings, UadpWriterGroupMessage):
        kinds["MessageSettings"] = "UadpWriterGroupMessageType"
        values |= {
            "MessageSettings.GroupVersion": settings.group_version,
            "MessageSettings.DataSetOrdering": settings.data_set_ordering,
            "MessageSettings.NetworkMessageContentMask": settings.network_message_content_mask,
            "MessageSettings.PublishingOffset": list(settings.publishing_offset),
        }
    elif isinstance(settings, JsonWriterGroupMessage):
        kinds["MessageSettings"] = "JsonWriterGroupMessageType"
        values["MessageSettings.NetworkMessageContentMask"] = settings.network_message_content_mask
    return _described("WriterGroupType", values, kinds, state, diagnostics, can_switch=can_switch)


def _group(mode: int, security_group: str | None, largest: int, properties: Iterable[Any]) -> dict[str, Any]:
    values = {
        "SecurityMode": mode,
        "MaxNetworkMessageSize": largest,
        "GroupProperties": key_value_pairs(properties),
    }
    return values if security_group is None else {**values, "SecurityGroupId": security_group}


def describe_writer(
    writer: DataSetWriter, state: Live, diagnostics: Diagnostics | None, *, can_switch: bool
) -> Description:
    """A DataSetWriter (9.1.7.2)."""
    values: dict[str, Any] = {
        "DataSetWriterId": writer.data_set_writer_id,
        "DataSetFieldContentMask": writer.data_set_field_content_mask,
        "KeyFrameCount": writer.key_frame_count,
        "DataSetWriterProperties": key_value_pairs(writer.properties),
    }
    kinds: dict[str, str] = {}
    if isinstance(settings := writer.message_settings, UadpDataSetWriterMessage):
        kinds["MessageSettings"] = "UadpDataSetWriterMessageType"
        values |= {
            "MessageSettings.DataSetMessageContentMask": settings.data_set_message_content_mask,
            "MessageSettings.ConfiguredSize": settings.configured_size,
            "MessageSettings.NetworkMessageNumber": settings.network_message_number,
            "MessageSettings.DataSetOffset": settings.data_set_offset,
        }
    elif isinstance(settings, JsonDataSetWriterMessage):
        kinds["MessageSettings"] = "JsonDataSetWriterMessageType"
        values["MessageSettings.DataSetMessageContentMask"] = settings.data_set_message_content_mask
    return _described("DataSetWriterType", values, kinds, state, diagnostics, can_switch=can_switch)


def describe_reader_group(
    mode: int, security_group: str | None, state: Live, diagnostics: Diagnostics | None
) -> Description:
    """A ReaderGroup (9.1.6.9), without its DataSetReaders; `mode` is the least that it takes."""
    values = _group(mode, security_group, 0, ())
    return _described("ReaderGroupType", values, {}, state, diagnostics, can_switch=True)


def describe_reader(
    reader: DataSetReader,
    metadata: Callable[[], DataSetMetaData],
    targets: Callable[[], Iterable[tuple[Any, NodeId]]],
    state: Live,
    diagnostics: Diagnostics | None,
) -> Description:
    """A DataSetReader (9.1.8.2).

    Args:
        reader: how it is configured.
        metadata: what it reads by now.
        targets: the DataSetFieldIds, with the Variables that the fields are written to.
        state: of it.
        diagnostics: of it.
    """
    values: dict[str, Any] = {
        "PublisherId": reader.publisher_id,
        "WriterGroupId": reader.writer_group_id,
        "DataSetWriterId": reader.data_set_writer_id,
        "DataSetMetaData": Live.plain(lambda: metadata_value(metadata())),
        "DataSetFieldContentMask": reader.data_set_field_content_mask,
        "MessageReceiveTimeout": reader.message_receive_timeout_ms,
        "KeyFrameCount": reader.key_frame_count,
        "HeaderLayoutUri": reader.header_layout_uri or "",
        "DataSetReaderProperties": key_value_pairs(reader.properties),
        "SubscribedDataSet.TargetVariables": Live.plain(lambda: [field_target(*target) for target in targets()]),
    }
    kinds = {"SubscribedDataSet": "TargetVariablesType"}
    return _described("DataSetReaderType", values, kinds, state, diagnostics, can_switch=True)


def describe_data_set(
    metadata: Callable[[], DataSetMetaData], variables: Callable[[], Iterable[NodeId]] | None
) -> Description:
    """A PublishedDataSet (9.1.4.2.1); one of Variables of this server (9.1.4.3.1) where these are given."""
    values: dict[str, Any] = {
        "ConfigurationVersion": Live.plain(lambda: version_value(metadata().configuration_version)),
        "DataSetMetaData": Live.plain(lambda: metadata_value(metadata())),
    }
    if variables is None:
        return Description("PublishedDataSetType", values)
    values["PublishedData"] = Live.plain(lambda: [published_variable(node) for node in variables()])
    return Description("PublishedDataItemsType", values)


def small_counts(configured: Callable[[], int], operational: Callable[[], int], what: str) -> dict[str, Any]:
    """The LiveValues Configured<what> and Operational<what>, which are UInt16."""
    return {f"Configured{what}": lambda: _small(configured()), f"Operational{what}": lambda: _small(operational())}
