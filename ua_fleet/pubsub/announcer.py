"""What a Publisher announces besides metadata: its configuration, its application, its Actions (OPC 10000-14 7.2.4.6).

Each thing that can be announced has a key. It is due when somebody asks for it, when it has changed, or, for the status
and for Actions, with a period. What is due already is not made due again, and two announcements with one key are at
least half a second apart: many who ask at once get one answer, and what changes often is said twice a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Final, NamedTuple

from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub.application import Application
from ua_fleet.pubsub.components import CONNECTION, Component, Components
from ua_fleet.pubsub.configuring import WriterGroups, connection, group_name, writer_group
from ua_fleet.pubsub.due import DueTimes
from ua_fleet.pubsub.layout import PLAIN, WriterSettings
from ua_fleet.pubsub.pacing import Pace
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND, StatusCode
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionResponderAnnouncement,
    AnyAnnouncement,
    ApplicationAnnouncement,
    ConnectionsAnnouncement,
    EndpointsAnnouncement,
    PubSubConnection,
    PubSubState,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
    WriterGroup,
)
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMetaData,
    MetaDataAnnouncement,
    Probe,
    ProbeKind,
    PublisherIdType,
)

__all__ = ["ANSWER_INTERVAL_S", "Announcer"]

ANSWER_INTERVAL_S: Final = 0.5
"""Announcements of one thing are at least so far apart (OPC 10000-14 7.2.4.6.12.2)."""
_WRITERS_IN_MESSAGE: Final = 10
"""DataSetWriters in one configuration announcement: with names of usual length it fits an Ethernet frame."""
_MOST_DENIALS: Final = 20
"""DataSetWriters of which a Publisher says, each half second, that it does not have them."""
_UINT16: Final = PublisherIdType.UINT16.value
_NOT_FOUND: Final = int(StatusCode.BAD_NOT_FOUND)
_NOT_SUPPORTED: Final = int(StatusCode.BAD_NOT_SUPPORTED)
_NO_METADATA: Final = DataSetMetaData("", (), ConfigurationVersion(0, 0))

_Make = Callable[[int, int, int, tuple[PubSubConnection, ...]], AnyAnnouncement]
"""Makes an announcement of connections."""


class _Key(NamedTuple):
    """What is announced; `id` is a WriterGroupId or a DataSetWriterId where there are several of a kind."""

    kind: str
    id: int = 0


_ENDPOINTS: Final = _Key("endpoints")
_CONNECTIONS: Final = _Key("connections")
_RESPONDER: Final = _Key("responder")
_APPLICATION: Final = _Key("application")
_STATUS: Final = _Key("status")
_UNKNOWN_WRITERS: Final = _Key("unknown writers")
_DENIALS: Final = _Key("denials")


class Announcer:
    """The announcements of one Publisher, with their times. Every method that sends returns datagrams, in order."""

    def __init__(
        self,
        publisher_id: int,
        timing: PubSubTiming,
        application: Application,
        number: Callable[[], int],
        pace: Pace,
        settings: Mapping[Topic, WriterSettings],
        components: Components,
    ) -> None:
        """Make an announcer.

        Args:
            publisher_id: of all announcements.
            timing: the periods.
            application: what the process says of itself.
            number: gives the next SequenceNumber, of which there is one row for all announcements of a Publisher.
            pace: what may be sent at once.
            settings: how DataSetWriters send that do not send key frames of Variants.
            components: what is disabled.
        """
        self._components = components
        self._id, self._timing, self.application = publisher_id, timing, application
        self._number, self._pace, self._settings = number, pace, settings
        self._groups = WriterGroups()
        self._actions: dict[int, tuple[int, ActionMetaDataAnnouncement]] = {}
        """With the WriterGroupId. A retired one stays, without targets, so that who missed it still learns it."""
        self._due = DueTimes[_Key]()
        self._said_at: dict[_Key, float] = {}
        self._writers_asked: dict[_Key, dict[int, None]] = {}
        """DataSetWriterIds that a due announcement is about."""
        self._parts_asked: dict[_Key, tuple[bool, bool]] = {}
        """Whether a due announcement of connections holds WriterGroups, and these their DataSetWriters."""
        self._wall_offset: int | None = None
        """Ticks of the wall clock at time 0; None while this is not Operational."""
        self._now = 0.0

    def begin(self, now: float, wall_ticks: int) -> list[bytes]:
        """Say who this is and that it is Operational, now and from now on with a period.

        Over a broker that is said once, with all that the broker is to keep: who comes later gets it from there.
        """
        self._wall_offset = 0
        self.set_clock(now, wall_ticks)
        self._want(_APPLICATION, now)
        self._want(_STATUS, now)
        if self.application.is_brokered:
            self._want_parts(_CONNECTIONS, now, (True, True))
            self._want_parts(_RESPONDER, now, (True, True))
            if self.application.endpoints:
                self._want(_ENDPOINTS, now)
        return self.poll(now)

    def describe(self, application: Application) -> None:
        """Say this of the process from now on; over a broker it is said at once."""
        self.application = application
        if application.is_brokered and self._wall_offset is not None:
            self._want(_ENDPOINTS, self._now)

    def end(self) -> list[bytes]:
        """Say that nothing more comes. The status is not cyclic: no next one is promised."""
        if self._wall_offset is None:
            return []
        self._wall_offset = None
        self._due.clear()
        return [self._encode(StatusAnnouncement(self._id, _UINT16, 0, False, PubSubState.DISABLED.value))]

    def set_clock(self, now: float, wall_ticks: int) -> None:
        """Take the time of the wall clock, which the status tells."""
        if self._wall_offset is not None:
            self._wall_offset = wall_ticks - round(now * TICKS_PER_SECOND)

    def put_writer(self, ns: int, writer_id: int, name: str, now: float) -> None:
        """A DataSetWriter is new, or has another name: say it soon, together with its neighbours."""
        if self._groups.put(ns, writer_id, name):
            self._tell_writer(ns, writer_id, now + ANSWER_INTERVAL_S)

    def remove_writer(self, ns: int, writer_id: int) -> None:
        """A DataSetWriter is gone: say that soon."""
        if self._groups.remove(ns, writer_id):
            self._tell_writer(ns, writer_id, self._now + ANSWER_INTERVAL_S)

    def names_of(self, writer_id: int) -> tuple[str, str] | None:
        """The names of the WriterGroup and of the DataSetWriter with an id, also of an Action's; None without one."""
        for ns in self._groups.of_writer(writer_id):
            return group_name(ns), self._groups.names(ns)[writer_id]
        if (entry := self._actions.get(writer_id)) is None:
            return None
        ns, action = entry
        name = action.request.name or str(writer_id)
        others = [other for other, (_, known) in self._actions.items() if known.request.name == action.request.name]
        return group_name(ns, are_actions=True), name if others[0] == writer_id else f"{name}-{writer_id}"

    def switched(self, component: Component, now: float) -> list[bytes]:
        """Tell of what was disabled or enabled: of a PubSubConnection at once, of the rest soon."""
        if self._wall_offset is None:
            return []
        if component == CONNECTION:
            self._want(_STATUS, now)
            self._want_parts(_CONNECTIONS, now, (True, True))
        elif self.application.is_brokered:
            self._want_parts(_CONNECTIONS, now, (True, True))
        else:
            ns, *writer_ids = [int(number) for number in component[1:]]
            self._want(_Key("group", ns), now, writer_ids)
        return self.poll(now)

    def configuration(self, number: int = 0) -> PubSubConnection:
        """A PubSubConnection of this process as it is announced, with its WriterGroups, these without writers."""
        application = self.application.connections[number]
        return self._connection(application, self._data_groups(False, application))

    def group(self, ns: int, number: int = 0) -> WriterGroup:
        """A WriterGroup as it is announced of a PubSubConnection, with its DataSetWriters."""
        return self._data_group(self.application.connections[number], ns, self._groups.names(ns).items())

    def _tell_writer(self, ns: int, writer_id: int, due: float) -> None:
        """Say what a DataSetWriter is now, once this is Operational."""
        if self._wall_offset is None:
            return
        if self.application.is_brokered:
            self._want_parts(_CONNECTIONS, due, (True, True))
        if self.application.is_grouped:
            self._want(_Key("group", ns), due, (writer_id,))

    def action(self, writer_id: int) -> ActionMetaDataAnnouncement | None:
        """The Action of a DataSetWriter as it is announced."""
        entry = self._actions.get(writer_id)
        return None if entry is None else entry[1]

    def actions(self) -> list[bytes]:
        """All Actions as they are announced, for one in this process; nothing of it is to be sent."""
        return [encode_announcement(action) for _, action in self._actions.values()]

    def put_action(self, ns: int, action: ActionMetaDataAnnouncement, now: float) -> list[bytes]:
        """Announce an Action that is new or has changed; without targets there is nothing to be asked of it any more.

        Raises:
            LocalWireError: it cannot be encoded, or is larger than what may be sent.
        """
        size = len(encode_announcement(action))
        if size > self.application.max_message_bytes:
            raise LocalWireError(f"the Action {action.request.name}: {size} bytes of metadata are too many")
        self._actions[action.data_set_writer_id] = ns, action
        self._want(_Key("action", action.data_set_writer_id), now)
        if self.application.is_brokered and self._wall_offset is not None:
            self._want_parts(_RESPONDER, now + ANSWER_INTERVAL_S, (True, True))
        return self.poll(now)

    def ask(self, probe: Probe, now: float) -> None:
        """Take a probe to this Publisher; `poll` answers it."""
        kind = probe.kind
        if kind == ProbeKind.FIND_APPLICATIONS:
            self._want(_APPLICATION, now)
            self._want(_STATUS, now)
        elif kind == ProbeKind.ENDPOINTS:
            self._want(_ENDPOINTS, now)
        elif kind == ProbeKind.DATA_SET_META_DATA:
            for writer_id in probe.data_set_writer_ids or tuple(self._actions):
                if writer_id in self._actions:
                    self._want(_Key("action", writer_id), now)
        elif kind == ProbeKind.DATA_SET_WRITER_CONFIGURATION:
            self._ask_writers(probe.data_set_writer_ids or self._groups.ids(), now)
        elif kind == ProbeKind.WRITER_GROUP_CONFIGURATION:
            for ns in (probe.writer_group_id,) if probe.writer_group_id else self._groups.numbers():
                self._ask_group(ns, probe.include_data_set_writers, now)
        elif not probe.transport_profile_uris or any(
            each.profile in probe.transport_profile_uris for each in self.application.connections
        ):
            parts = probe.include_writer_groups, probe.include_writer_groups and probe.include_data_set_writers
            self._want_parts(_CONNECTIONS, now, parts)
            if self._actions:
                self._want_parts(_RESPONDER, now, parts)

    def deny(self, writer_ids: Iterable[int], now: float) -> None:
        """Say of some DataSetWriters that there is no metadata of them, unless they have an Action."""
        self._want_denied(_DENIALS, [writer_id for writer_id in writer_ids if writer_id not in self._actions], now)

    def poll(self, now: float) -> list[bytes]:
        """Send what is due, as far as receivers can follow."""
        self._now = now
        datagrams: list[bytes] = []
        while self._due.is_due(now) and self._pace.allows(now):
            key = self._due.pop()
            self._said_at[key] = now
            for announcement in self._announcements(key, now):
                datagram = self._encode(announcement)
                self._pace.take(len(datagram), datagrams=1)
                datagrams.append(datagram)
            if self._writers_asked.get(key):  # the rest of the same answer
                self._due.put(key, now)
            self._want_again(key, now)
        return datagrams

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self._due.next()

    def _want(self, key: _Key, due: float, writer_ids: Iterable[int] = ()) -> None:
        if writer_ids:
            self._writers_asked.setdefault(key, {}).update(dict.fromkeys(writer_ids))
        due = max(due, self._said_at.get(key, float("-inf")) + ANSWER_INTERVAL_S)
        known = self._due.get(key)
        if known is None or due < known:
            self._due.put(key, due)

    def _want_denied(self, key: _Key, writer_ids: list[int], now: float) -> None:
        writer_ids = writer_ids[: _MOST_DENIALS - len(self._writers_asked.get(key, ()))]
        if writer_ids:
            self._want(key, now, writer_ids)

    def _want_parts(self, key: _Key, due: float, parts: tuple[bool, bool]) -> None:
        groups, writers = self._parts_asked.get(key, (False, False))
        self._parts_asked[key] = groups or parts[0], writers or parts[1]
        self._want(key, due)

    def _want_again(self, key: _Key, now: float) -> None:
        if self._wall_offset is None:
            return
        if key == _STATUS:
            # Over a broker its end is told by that one. What is Disabled is not said again (7.2.4.6.7).
            if self.application.is_grouped and self._components.is_enabled(CONNECTION):
                self._want(key, now + self._timing.status_interval_s)
        elif key == _APPLICATION or key.kind == "action":
            self._want(key, now + self._timing.announce_interval_s)

    def _ask_writers(self, writer_ids: Sequence[int], now: float) -> None:
        asked: dict[_Key, list[int]] = {}
        for writer_id in writer_ids:
            for key in [_Key("group", ns) for ns in self._groups.of_writer(writer_id)] or [_UNKNOWN_WRITERS]:
                asked.setdefault(key, []).append(writer_id)
        self._want_denied(_UNKNOWN_WRITERS, asked.pop(_UNKNOWN_WRITERS, []), now)
        for key, ids in asked.items():
            self._want(key, now, ids)

    def _ask_group(self, ns: int, with_writers: bool, now: float) -> None:
        if names := self._groups.names(ns):
            self._want(_Key("group", ns), now, names if with_writers else ())

    def _announcements(self, key: _Key, now: float) -> Iterable[AnyAnnouncement]:
        """What there is to say under a key now."""
        head = self._id, _UINT16, 0
        application = self.application
        asked = self._take_asked(key)
        parts = self._parts_asked.pop(key, (False, False))
        if key.kind == "group":
            return [self._group_announcement(key.id, asked)]
        if key.kind == "action":
            return [self._actions[key.id][1]]
        if key == _UNKNOWN_WRITERS:
            nothing = WriterGroup(None, False)
            return [WriterConfigurationAnnouncement(*head, asked, nothing, (_NOT_FOUND,) * len(asked))]
        if key == _DENIALS:
            return [MetaDataAnnouncement(*head, writer_id, _NO_METADATA, _NOT_FOUND) for writer_id in asked]
        if key == _ENDPOINTS:
            return [EndpointsAnnouncement(*head, application.endpoints, 0 if application.endpoints else _NOT_SUPPORTED)]
        if key == _CONNECTIONS:
            return [self._fitting(ConnectionsAnnouncement, parts, self._data_groups)]
        if key == _RESPONDER:
            return [self._fitting(ActionResponderAnnouncement, parts, self._action_groups)]
        if key == _APPLICATION:
            return [ApplicationAnnouncement(*head, application.description, application.capabilities)]
        if self._wall_offset is None:
            return []
        if not self._components.is_enabled(CONNECTION):
            return [StatusAnnouncement(*head, False, PubSubState.DISABLED.value)]
        if not application.is_grouped:
            return [StatusAnnouncement(*head, False, PubSubState.OPERATIONAL.value)]
        wall = self._wall_offset + round(now * TICKS_PER_SECOND)
        following = wall + round(self._timing.status_interval_s * TICKS_PER_SECOND)
        return [StatusAnnouncement(*head, True, PubSubState.OPERATIONAL.value, following, wall)]

    def _take_asked(self, key: _Key) -> tuple[int, ...]:
        """Some of the DataSetWriters that an announcement is to be about, and no more than a datagram holds."""
        asked = self._writers_asked.get(key)
        if not asked:
            return ()
        part = tuple(islice(asked, _WRITERS_IN_MESSAGE))
        for writer_id in part:
            del asked[writer_id]
        return part

    def _group_announcement(self, ns: int, ids: tuple[int, ...]) -> AnyAnnouncement:
        names = self._groups.names(ns)
        writers = [(writer_id, names[writer_id]) for writer_id in ids if writer_id in names]
        group = self._data_group(self.application, ns, writers)
        statuses = tuple([0 if writer_id in names else _NOT_FOUND for writer_id in ids])
        return WriterConfigurationAnnouncement(self._id, _UINT16, 0, ids, group, statuses)

    def _data_groups(self, with_writers: bool, application: Application) -> list[WriterGroup]:
        return [
            self._data_group(application, ns, self._groups.names(ns).items() if with_writers else ())
            for ns in self._groups.numbers()
        ]

    def _data_group(self, application: Application, ns: int, writers: Iterable[tuple[int, str]]) -> WriterGroup:
        return writer_group(
            application,
            self._timing,
            ns,
            writers,
            settings=lambda writer_id: self._settings.get(Topic(self._id, ns, writer_id), PLAIN),
            is_enabled=self._components.is_enabled,
        )

    def _action_groups(self, with_writers: bool, application: Application) -> list[WriterGroup]:
        if not application.takes_actions:
            return []
        writers: dict[int, list[tuple[int, str]]] = {}
        for writer_id, (ns, action) in self._actions.items():
            if action.targets:
                writers.setdefault(ns, []).append((writer_id, action.request.name))
        return [
            writer_group(application, self._timing, ns, ids if with_writers else (), are_actions=True)
            for ns, ids in writers.items()
        ]

    def _fitting(
        self,
        make: _Make,
        parts: tuple[bool, bool],
        groups_of: Callable[[bool, Application], list[WriterGroup]],
    ) -> AnyAnnouncement:
        """The connections with what was asked for, as far as one message can hold it: other probes ask for the rest."""
        with_groups, with_writers = parts
        choices = [True] * (with_groups and with_writers) + [False] * with_groups
        for has_writers in choices:
            announcement = self._whole(make, partial(groups_of, has_writers))
            if len(encode_announcement(announcement)) <= self.application.max_message_bytes:
                return announcement
        return self._whole(make, lambda _: [])

    def _whole(self, make: _Make, groups_of: Callable[[Application], list[WriterGroup]]) -> AnyAnnouncement:
        made = [self._connection(each, groups_of(each)) for each in self.application.connections]
        if make is not ConnectionsAnnouncement:
            made = [each._replace(enabled=True) for each in made]
        return make(self._id, _UINT16, 0, tuple(made))

    def _connection(self, application: Application, groups: list[WriterGroup]) -> PubSubConnection:
        made = connection(application, self._timing, self._id, tuple(groups))
        return made._replace(enabled=self._components.is_enabled(CONNECTION))

    def _encode(self, announcement: AnyAnnouncement) -> bytes:
        return encode_announcement(announcement._replace(sequence_number=self._number()))
