"""What publishers announce of themselves: metadata for the readers, Actions and the rest for whoever wants them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.catalog import Catalog
from ua_fleet.pubsub.events import AnnouncementReceived, SubscriberEvent
from ua_fleet.pubsub.inlet import Inlet
from ua_fleet.pubsub.liveness import Liveness
from ua_fleet.pubsub.mapped import MappedSources, PublisherKey, publisher_key
from ua_fleet.pubsub.probing import ProbeSchedule
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.pubsub.wishes import Wishes
from ua_fleet.values import Quality, quality_of
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, AnyAnnouncement, PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import ConfigurationVersion, MetaDataAnnouncement
from ua_fleet.wire.security import SecurityMode

__all__ = ["Announcements"]

_MOST_MODES: Final = 10_000
"""Announcements of one Publisher of which is known how they were secured. Of one that makes more, all count as so."""
_ALL: Final[tuple[type, int]] = (object, 0)
"""In place of one of its announcements."""


class Announcements:
    """What of announcements counts."""

    def __init__(
        self,
        timeout_s: float,
        counters: Counters,
        max_writers: int,
        *,
        inlets: Sequence[Inlet],
        comes_in: Callable[[int], bool],
        mapped: MappedSources,
        writers: Mapping[Any, RemoteWriter],
        catalog: Catalog,
        liveness: Liveness,
        probes: ProbeSchedule,
        wishes: Wishes,
    ) -> None:
        """Connect them.

        Args:
            timeout_s: MessageReceiveTimeout.
            counters: what is dropped is counted here.
            max_writers: DataSetWriters with Actions that are remembered at most.
            inlets: one for each connection.
            comes_in: what the loop rule says to a publisher.
            mapped: DataSetWriters of publishers that are no bridges.
            writers: those that were heard.
            catalog: takes metadata.
            liveness: learns that a publisher has ended.
            probes: learns that metadata has come.
            wishes: learns of each announcement.
        """
        self._timeout, self._counters, self._max_writers, self._inlets = timeout_s, counters, max_writers, inlets
        self._comes_in, self._mapped, self._writers = comes_in, mapped, writers
        self._catalog, self._liveness, self._probes, self._wishes = catalog, liveness, probes, wishes
        self._action_versions: dict[tuple[int | str | None, int], ConfigurationVersion] = {}
        """The latest of each DataSetWriter with Actions."""
        self._modes: dict[PublisherKey, dict[tuple[type, int], SecurityMode]] = {}
        """What the announcements of a Publisher had that made what is known of a DataSetWriter, where that is not NONE.

        There are as many Publishers as have keys, and `_MOST_MODES` of each."""

    def take(self, announcement: AnyAnnouncement, inlet: Inlet, now: float, *, is_fresh: bool) -> list[SubscriberEvent]:
        """Take an announcement that came by an inlet; `is_fresh` as in `Subscriber.receive`."""
        publisher_id = announcement.publisher_id
        if publisher_id is None:
            self._counters.drop(Drop.UNKNOWN_SOURCE)
            return []
        publisher = publisher_key(announcement.publisher_id_type, publisher_id)
        if not isinstance(publisher, int):
            if not self._mapped.knows(publisher) or not isinstance(announcement, MetaDataAnnouncement):
                self._counters.drop(Drop.UNKNOWN_SOURCE)
                return []
        elif not self._comes_in(publisher):
            self._counters.drop(Drop.LOOP)
            return []
        if len(self._inlets) > 1 and self._is_outranked(announcement, publisher, inlet):
            self._counters.drop(Drop.NOT_SECURED)
            return []
        if isinstance(announcement, ActionMetaDataAnnouncement) and not self._is_latest(
            announcement, is_fresh=is_fresh
        ):
            self._counters.drop(Drop.RETAINED)
            return []
        self._wishes.heard(announcement)
        if isinstance(announcement, StatusAnnouncement):
            return [AnnouncementReceived(announcement, is_fresh), *self._ended(publisher, announcement, inlet, now)]
        if not isinstance(announcement, MetaDataAnnouncement):
            return [AnnouncementReceived(announcement, is_fresh)]
        key = (publisher, announcement.data_set_writer_id)
        if quality_of(announcement.status) is not Quality.BAD and not self._catalog.announced(
            key, announcement.metadata, is_fresh=is_fresh
        ):
            self._counters.drop(Drop.RETAINED)
            return []
        self._probes.answered(key)
        return []

    def _is_latest(self, announcement: ActionMetaDataAnnouncement, *, is_fresh: bool) -> bool:
        """Whether no later version of an Action is known; of a fresh one it is not asked. The latest is noted."""
        key = announcement.publisher_id, announcement.data_set_writer_id
        version = announcement.request.configuration_version
        known = self._action_versions.get(key)
        if not is_fresh and known is not None and known > version:
            return False
        if known is None and len(self._action_versions) >= self._max_writers:
            del self._action_versions[next(iter(self._action_versions))]
        self._action_versions[key] = version
        return True

    def _is_outranked(self, announcement: AnyAnnouncement, publisher: PublisherKey, inlet: Inlet) -> bool:
        """Whether what is known of it came by a connection with more security: this changes nothing of that.

        Without this, an unsecured connection would say what the values of a secured one mean, and where its publisher
        is. A status is of one connection.
        """
        if isinstance(announcement, StatusAnnouncement):
            return False
        writer_id = 0
        if isinstance(announcement, MetaDataAnnouncement | ActionMetaDataAnnouncement):
            writer_id = announcement.data_set_writer_id
        key: tuple[type, int] = type(announcement), writer_id
        modes = self._modes.get(publisher, {})
        if inlet.mode < modes.get(key, modes.get(_ALL, SecurityMode.NONE)):
            return True
        if inlet.mode is not SecurityMode.NONE:
            if key not in modes and len(modes) >= _MOST_MODES:  # to forget one would let it be changed
                key, modes = _ALL, {_ALL: max(inlet.mode, *modes.values())}
            modes[key] = inlet.mode
            self._modes[publisher] = modes
        return False

    def _ended(
        self, publisher: PublisherKey, status: StatusAnnouncement, inlet: Inlet, now: float
    ) -> list[SubscriberEvent]:
        """A publisher's connection is in error, as its broker says by the will: its sources are silent at once.

        Not while the publisher is heard by another connection. A will may be heard again at any time, by whoever
        recorded it: so a status makes nothing Good.
        """
        events: list[SubscriberEvent] = []
        name, never = status.publisher_id, float("-inf")
        others = [other.heard_at.get(name, never) for other in self._inlets if other is not inlet]
        if status.state == PubSubState.ERROR and now - max(others, default=never) >= self._timeout:
            for writer in self._writers.values():
                if writer.key[0] == publisher:
                    self._liveness.end(writer, events)
        return events
