"""What a consumer wants to be announced besides metadata, asked for until it comes (OPC 10000-14 7.2.4.6.12.2).

Actions are asked for as metadata is, by their DataSetWriterId: no probe has a kind of its own for them (table 179).
"""

from __future__ import annotations

from random import Random
from typing import Final

from ua_fleet.pubsub.probing import ProbeSchedule
from ua_fleet.values import Quality, quality_of
from ua_fleet.wire import encode_probe
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    AnyAnnouncement,
    ConnectionsAnnouncement,
    EndpointsAnnouncement,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import MetaDataAnnouncement, Probe, ProbeKind, PublisherIdType

__all__ = ["IDS_IN_PROBE", "Wishes"]

IDS_IN_PROBE: Final = 256
"""DataSetWriterIds of one probe, which fits the smallest datagram that may be configured: a probe has no chunks."""
_UINT16: Final = PublisherIdType.UINT16.value
_ANSWERS: Final[dict[type, ProbeKind]] = {
    EndpointsAnnouncement: ProbeKind.ENDPOINTS,
    WriterConfigurationAnnouncement: ProbeKind.DATA_SET_WRITER_CONFIGURATION,
    ConnectionsAnnouncement: ProbeKind.PUBSUB_CONNECTIONS,
}

_Key = tuple[int, int]
"""PublisherId, and a DataSetWriterId of Actions or a ProbeKind with a minus sign."""


class Wishes:
    """Probes for what is wanted of Publishers, with the delays that the specification asks for."""

    def __init__(self, random: Random, *, most: int = 4096) -> None:
        """Want nothing.

        Args:
            random: where the random delay of first probes comes from.
            most: wishes at a time; what comes on top is not asked for.
        """
        self._schedule = ProbeSchedule(random)
        self._wanted: dict[_Key, None] = {}
        self._most = most

    def want_action(self, publisher_id: int, data_set_writer_id: int, now: float) -> bool:
        """Ask for the Actions of a DataSetWriter, soon and until they come; False if there are too many wishes."""
        return self._want((publisher_id, data_set_writer_id), now)

    def unwant_action(self, publisher_id: int, data_set_writer_id: int) -> None:
        """Ask no longer for the Actions of a DataSetWriter."""
        self._end((publisher_id, data_set_writer_id))

    def want(self, publisher_id: int, kind: ProbeKind, now: float) -> bool:
        """Ask a Publisher for its endpoints, connections or DataSetWriters, until they come."""
        if kind not in _ANSWERS.values():
            raise ValueError(f"{kind!r} is asked for otherwise")
        return self._want((publisher_id, -kind), now)

    def asked_by_another(self, probe: Probe, now: float) -> None:
        """Somebody asks a Publisher: wait for that answer."""
        publisher_id = probe.publisher_id
        if not isinstance(publisher_id, int):
            return
        if probe.kind == ProbeKind.DATA_SET_META_DATA:
            codes = probe.data_set_writer_ids or tuple([code for _, code in self._wanted if code >= 0])
        else:
            codes = (-probe.kind,)
        self._schedule.asked_by_another(publisher_id, codes, now)

    def heard(self, announcement: AnyAnnouncement) -> None:
        """An announcement came: what was wanted is there, or denied."""
        publisher_id = announcement.publisher_id
        if isinstance(announcement, ActionMetaDataAnnouncement):
            code = announcement.data_set_writer_id
        elif isinstance(announcement, MetaDataAnnouncement):
            if quality_of(announcement.status) is not Quality.BAD:
                return
            code = announcement.data_set_writer_id
        else:
            kind = _ANSWERS.get(type(announcement))
            if kind is None:
                return
            code = -kind
        if isinstance(publisher_id, int):
            self._end((publisher_id, code))

    def take_due(self, now: float) -> list[bytes]:
        """The probes to send now. One asks a Publisher for the Actions of many DataSetWriters."""
        probes: list[Probe] = []
        actions: dict[int, list[int]] = {}
        for publisher_id, code in self._schedule.take_due(now):
            assert isinstance(publisher_id, int)  # nothing else is wanted of others
            if code >= 0:
                actions.setdefault(publisher_id, []).append(code)
            else:
                probes.append(
                    Probe(publisher_id, _UINT16, -code, include_writer_groups=True, include_data_set_writers=True)
                )
        for publisher_id, ids in actions.items():
            for start in range(0, len(ids), IDS_IN_PROBE):
                part = tuple(sorted(ids[start : start + IDS_IN_PROBE]))
                probes.append(Probe(publisher_id, _UINT16, ProbeKind.DATA_SET_META_DATA.value, part))
        return [encode_probe(probe) for probe in probes]

    def next_deadline(self) -> float | None:
        """When the next probe is due, or None."""
        return self._schedule.next_deadline()

    def _end(self, key: _Key) -> None:
        if key in self._wanted:
            del self._wanted[key]
            self._schedule.settled(key)

    def _want(self, key: _Key, now: float) -> bool:
        if key not in self._wanted:
            if len(self._wanted) >= self._most:
                return False
            self._wanted[key] = None
            self._schedule.want(key, now)
        return True
