"""Announcements as tables for people. All text is a peer's: what a terminal might obey is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from ua_fleet.cli.kind import HealthKind
from ua_fleet.cli.value_json import time_text
from ua_fleet.printing import harmless
from ua_fleet.values import BuiltinType, status_name
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    AnyAnnouncement,
    ApplicationAnnouncement,
    ApplicationType,
    ConnectionsAnnouncement,
    EndpointsAnnouncement,
    NetworkAddressUrl,
    PubSubState,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import DataSetMetaData, MetaDataAnnouncement

__all__ = ["table"]

HEADINGS = {
    HealthKind.METADATA: ("publisher", "writer", "DataSet", "version", "fields"),
    HealthKind.WRITERS: ("publisher", "group", "writer", "DataSet", "security", "security group", "keep-alive"),
    HealthKind.GROUPS: ("publisher", "group", "name", "security", "security group", "keep-alive"),
    HealthKind.CONNECTIONS: ("publisher", "connection", "transport", "address", "groups", "writers"),
    HealthKind.ENDPOINTS: ("publisher", "endpoint", "security", "policy"),
    HealthKind.APPLICATIONS: ("publisher", "application", "type", "state", "next report", "uri"),
    HealthKind.ACTIONS: ("publisher", "writer", "Action", "version", "targets", "request", "response"),
}
SECURITY = {1: "none", 2: "sign", 3: "sign and encrypt"}


def table(kind: HealthKind, announcements: Iterable[AnyAnnouncement]) -> list[list[str]]:
    """Rows, the heading first, sorted by publisher and what comes next."""
    heard = list(announcements)
    if kind is HealthKind.APPLICATIONS:
        rows = _applications(heard)
    else:
        rows = [row for announcement in heard for row in _rows(kind, announcement)]
    unique = sorted({tuple(map(harmless, map(str, row))) for row in rows}, key=_natural)
    return [list(HEADINGS[kind]), *map(list, unique)]


def _natural(row: tuple[str, ...]) -> tuple[tuple[int, str], ...]:
    return tuple((int(cell) if cell.isdecimal() and len(cell) < 18 else -1, cell) for cell in row)


def _rows(kind: HealthKind, heard: AnyAnnouncement) -> Iterator[tuple[object, ...]]:
    publisher = heard.publisher_id
    if isinstance(heard, MetaDataAnnouncement):
        shown = _fields(heard.metadata) if heard.status == 0 else status_name(heard.status)
        yield publisher, heard.data_set_writer_id, heard.metadata.name, _version(heard.metadata), shown
    elif isinstance(heard, WriterConfigurationAnnouncement):
        yield from _groups(kind, heard)
    elif isinstance(heard, ConnectionsAnnouncement):
        for connection in heard.connections:
            address = connection.address
            url = f"{address.url} on {address.network_interface}" if isinstance(address, NetworkAddressUrl) else ""
            groups = connection.writer_groups
            transport = (connection.transport_profile_uri or "").rpartition("/")[2]
            writers = sum(len(group.data_set_writers) for group in groups)
            yield publisher, connection.name or "", transport, url, len(groups), writers
    elif isinstance(heard, EndpointsAnnouncement):
        if not heard.endpoints:
            yield publisher, status_name(heard.status), "", ""
        for endpoint in heard.endpoints:
            policy = (endpoint.security_policy_uri or "").rpartition("#")[2]
            yield publisher, endpoint.endpoint_url or "", SECURITY.get(endpoint.security_mode, "?"), policy
    elif isinstance(heard, ActionMetaDataAnnouncement):
        targets = ", ".join(f"{target.action_target_id} {target.name or ''}" for target in heard.targets) or "retired"
        request, response = heard.request, heard.response
        version = _version(request)
        yield publisher, heard.data_set_writer_id, request.name, version, targets, _fields(request), _fields(response)


def _groups(kind: HealthKind, heard: WriterConfigurationAnnouncement) -> Iterator[tuple[object, ...]]:
    group = heard.writer_group
    security = SECURITY.get(group.security_mode, "?"), group.security_group_id or "", f"{group.keep_alive_time_ms:g} ms"
    if kind is HealthKind.GROUPS:
        yield heard.publisher_id, group.writer_group_id, group.name or "", *security
        return
    for writer in group.data_set_writers:
        name = writer.data_set_name or writer.name or ""
        yield heard.publisher_id, group.writer_group_id, writer.data_set_writer_id, name, *security
    for writer_id, status in zip(heard.data_set_writer_ids, heard.statuses, strict=True):
        if status:
            yield heard.publisher_id, group.writer_group_id, writer_id, status_name(status), "", "", ""


def _applications(heard: list[AnyAnnouncement]) -> list[tuple[object, ...]]:
    """Who they are beside how they are, both of the latest that was heard."""
    latest = {(type(announcement), announcement.publisher_id): announcement for announcement in heard}
    rows: list[tuple[object, ...]] = []
    for publisher in dict.fromkeys(publisher for _, publisher in latest):
        who = latest.get((ApplicationAnnouncement, publisher))
        how = latest.get((StatusAnnouncement, publisher))
        name = kind = uri = state = following = ""
        if isinstance(who, ApplicationAnnouncement):
            description = who.description
            name, uri = description.application_name.text or "", description.application_uri or ""
            kind = _named(ApplicationType, description.application_type)
        if isinstance(how, StatusAnnouncement):
            state, following = _named(PubSubState, how.state), time_text(how.next_report_time) or ""
        rows.append((publisher, name, kind, state, following, uri))
    return rows


def _named(kind: type[ApplicationType | PubSubState], number: int) -> str:
    return kind(number).name.lower().replace("_", " ") if number in list(kind) else str(number)


def _version(metadata: DataSetMetaData) -> str:
    version = metadata.configuration_version
    return f"{version.major}.{version.minor}"


def _fields(metadata: DataSetMetaData) -> str:
    shown: list[str] = []
    for field in metadata.fields:
        known = BuiltinType.BOOLEAN <= field.builtin_type <= BuiltinType.DIAGNOSTIC_INFO
        name = BuiltinType(field.builtin_type).name.lower() if known else str(field.builtin_type)
        shown.append(f"{field.name} {name}{'[]' if field.value_rank > 0 else ''}")
    return ", ".join(shown)
