"""The PubSubConnection of a bridge as it has announced it. Pure: announcements in, a description out.

    ConnectionsAnnouncement            its PubSubConnection, its WriterGroups, and their DataSetWriters where these fit
    WriterConfigurationAnnouncement    a WriterGroup, and some DataSetWriters of it; or that there is no such one
    StatusAnnouncement                 whether its PubSubConnection is Disabled

What is Disabled stands in these, too. While nothing is heard of a bridge its states are what they were, and not Good.

A bridge of which the DataSetWriter of its status, or what this is part of, is Disabled is silent since it was told so:
that is no lost communication. It is there while it announces something now and then, for which it is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, Protocol

from ua_fleet.operation.pubsub.description import (
    Description,
    Diagnostics,
    Live,
    Shown,
    describe_connection,
    describe_data_set,
    describe_writer,
    describe_writer_group,
)
from ua_fleet.operation.pubsub.difference import Part
from ua_fleet.pubsub.components import CONNECTION, Component, parent_of, writer, writer_group
from ua_fleet.topics import Topic
from ua_fleet.values import Quality, StatusCode, quality_of
from ua_fleet.wire.discovered import (
    AnyAnnouncement,
    ConnectionsAnnouncement,
    DataSetWriter,
    PubSubConnection,
    PubSubState,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
    WriterGroup,
)
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData

__all__ = ["AnnouncedConnection", "MetaDataOf", "key_of"]

NO_METADATA: Final = DataSetMetaData("", (), ConfigurationVersion(0, 0))
MOST_GROUPS: Final = 256
"""WriterGroups that are shown of a bridge: anybody could announce any number in its name."""
MOST_WRITERS: Final = 20_000
"""DataSetWriters that are shown of a bridge, over all its WriterGroups."""
MOST_CONNECTIONS: Final = 16
"""PubSubConnections that are kept of a bridge."""
PATIENCE_S: Final = 25.0
"""How long a bridge whose status is not sent may announce nothing. It is asked more often."""
_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)


class MetaDataOf(Protocol):
    """Where the metadata of what a bridge sends is known."""

    def __call__(self, topic: Topic) -> DataSetMetaData | None:
        """The metadata of a source; None where none is known."""
        ...


def key_of(bridge: str) -> str:
    """What the NodeIds of a bridge's connection begin with."""
    return f"PubSub.bridges.{bridge}"


class Tells(Protocol):
    """What a bridge tells of its components, as `operation.pubsub.told` has it."""

    def __call__(self, component: Component, number: int = 0, key: str = "") -> Diagnostics | None:
        """What it has counted of a component at its connection with a number; None where it says nothing."""
        ...

    def reset(self, component: Component, number: int = 0, key: str = "") -> bool:
        """Begin to count anew; False where nothing is counted."""
        ...

    def has_problem(self, number: int) -> bool:
        """Whether the connection is in the state Error."""
        ...


class _Silence:
    """A bridge that tells nothing."""

    def __call__(self, component: Component, number: int = 0, key: str = "") -> Diagnostics | None:
        del component, number, key
        return None

    def reset(self, component: Component, number: int = 0, key: str = "") -> bool:
        del component, number, key
        return False

    def has_problem(self, number: int) -> bool:
        del number
        return False


class AnnouncedConnection:
    """See ShownConnection."""

    has_data_sets = True

    def __init__(
        self,
        name: str,
        space: int,
        *,
        metadata: MetaDataOf,
        is_heard: Callable[[], bool],
        told: Tells | None = None,
        status: Topic | None = None,
    ) -> None:
        """Know nothing of a bridge.

        Args:
            name: the bridge's.
            space: its own, which is the PublisherId of its announcements.
            metadata: of what it sends.
            is_heard: whether the bridge is heard.
            told: what it says that it has counted; left out: nothing.
            status: its status DataSet, by which it is heard; None where it has none.
        """
        self.key, self.name, self.space = key_of(name), name, space
        self._metadata, self._is_heard, self.told = metadata, is_heard, told or _Silence()
        self._status = None if status is None else writer(status.ns, status.id)
        self._announced_at: float | None = None
        """When it announced something last."""
        self._answers = False
        self._connection: PubSubConnection | None = None
        self._further: tuple[PubSubConnection, ...] = ()
        """Its other connections, as they were announced."""
        self._groups: dict[int, WriterGroup] = {}
        self._writers: dict[int, dict[int, DataSetWriter]] = {}

    @property
    def is_announced(self) -> bool:
        """Whether anything is known of it."""
        return self._connection is not None

    @property
    def is_muted(self) -> bool:
        """Whether nothing tells each second that it is there: its status is not sent."""
        return self.is_announced and (self._status is None or self.state(self._status) is not PubSubState.OPERATIONAL)

    def look(self, now: float) -> None:
        """Note whether it has announced something lately. To be called each second."""
        self._answers = self._announced_at is not None and now - self._announced_at < PATIENCE_S

    def heard(self, announcement: AnyAnnouncement, now: float, *, is_fresh: bool = True) -> None:
        """Take what the bridge announces; `is_fresh` as in AnnouncementReceived."""
        self._attest(announcement, now, is_fresh=is_fresh)
        if isinstance(announcement, ConnectionsAnnouncement):
            if announcement.connections:
                self._take_connection(announcement.connections[0])
                self._further = announcement.connections[1:MOST_CONNECTIONS]
        elif isinstance(announcement, WriterConfigurationAnnouncement):
            self._take_writers(announcement)
        elif isinstance(announcement, StatusAnnouncement) and self._connection is not None:
            is_disabled = announcement.state == PubSubState.DISABLED
            if is_disabled or announcement.state == PubSubState.OPERATIONAL:
                self._connection = self._connection._replace(enabled=not is_disabled)

    def _attest(self, announcement: AnyAnnouncement, now: float, *, is_fresh: bool) -> None:
        """Note whether the bridge is there. Who has recorded a will may say it at any time: it can only end that."""
        if not isinstance(announcement, StatusAnnouncement):
            if is_fresh:
                self._announced_at, self._answers = now, True
        elif announcement.state == PubSubState.ERROR:
            self._announced_at, self._answers = None, False

    def lacks(self, topics: Iterable[Topic]) -> bool:
        """Whether it has not announced the DataSetWriter of one of these, which it sends."""
        return any(topic.id not in self._writers.get(topic.ns, ()) for topic in topics)

    def forget(self) -> None:
        """Nothing is known of it any more."""
        self._connection, self._further, self._groups, self._writers = None, (), {}, {}

    def is_enabled(self, component: Component) -> bool:
        """Whether a component is enabled itself, as was announced."""
        if component == CONNECTION:
            return self._connection is None or self._connection.enabled
        number = int(component[1])
        if component == writer_group(number):
            return number not in self._groups or self._groups[number].enabled
        known = self._writers.get(number, {}).get(int(component[2]))
        return known is None or known.enabled

    def has(self, component: Component) -> bool:
        """Whether there is such a component."""
        if component == CONNECTION:
            return self._connection is not None
        if component[0] != "W":
            return False
        number = int(component[1])
        if component == writer_group(number):
            return number in self._groups
        return component[2] in self._writers.get(number, {})

    def switched(self, component: Component, *, is_enabled: bool) -> None:
        """The bridge has disabled or enabled a component, as it was asked."""
        if component == CONNECTION:
            if self._connection is not None:
                self._connection = self._connection._replace(enabled=is_enabled)
            return
        number = int(component[1])
        if component == writer_group(number):
            self._groups[number] = self._groups[number]._replace(enabled=is_enabled)
        else:
            writers, writer_id = self._writers[number], int(component[2])
            writers[writer_id] = writers[writer_id]._replace(enabled=is_enabled)

    def state(self, component: Component) -> PubSubState:
        """The state of a component, as far as it was announced."""
        if not self.is_enabled(component):
            return PubSubState.DISABLED
        above = parent_of(component)
        while above is not None:
            if not self.is_enabled(above):
                return PubSubState.PAUSED
            above = parent_of(above)
        return PubSubState.OPERATIONAL

    def connection(self) -> Part | None:
        """See ShownConnection."""
        if self._connection is None:
            return None
        return Part(f"bridge {self.name}", (self._connection._replace(enabled=True), self.tells_of(CONNECTION)))

    def groups(self) -> Mapping[Component, Part]:
        """See ShownConnection."""
        return {
            writer_group(number): Part(
                group.name or str(number), (group._replace(enabled=True), self.tells_of(writer_group(number)))
            )
            for number, group in self._groups.items()
        }

    def tells_of(self, component: Component, number: int = 0) -> bool:
        """Whether the bridge tells what it has counted: what is shown before its first status has no Diagnostics."""
        return self.told(component, number) is not None

    def members(self, group: Component) -> Mapping[Component, Part]:
        """See ShownConnection."""
        number = int(group[1])
        return {
            writer(number, writer_id): Part(each.name or str(writer_id), each._replace(enabled=True))
            for writer_id, each in self._writers.get(number, {}).items()
        }

    def data_sets(self) -> Mapping[Topic, Part]:
        """See ShownConnection."""
        found: dict[Topic, Part] = {}
        for number, writers in self._writers.items():
            for writer_id, each in writers.items():
                topic = Topic(self.space, number, writer_id)
                if self._metadata(topic) is not None:
                    found[topic] = Part(each.data_set_name or each.name or topic.name, None)
        return found

    def writers_of(self, topic: Topic) -> list[Component]:
        """See ShownConnection."""
        return [writer(topic.ns, topic.id)]

    def describe(self, component: Component) -> Description:
        """See ShownConnection."""
        state = self.further_state(0, component)
        diagnostics = self.told(component)
        if component == CONNECTION:
            assert self._connection is not None
            return describe_connection(self._connection, state, diagnostics, can_switch=True)
        number = int(component[1])
        if component == writer_group(number):
            return describe_writer_group(self._groups[number], state, diagnostics, can_switch=True)
        own = self._writers[number][int(component[2])]
        return describe_writer(own, state, diagnostics, can_switch=True)

    def further(self, number: int) -> PubSubConnection | None:
        """The connection with this number, from 1 on; None where none was announced."""
        return self._further[number - 1] if number <= len(self._further) else None

    def further_writers(self, number: int, group: int) -> tuple[DataSetWriter, ...]:
        """The DataSetWriters of a group as they are on the connection with this number."""
        known = self.further(number)
        found = [each for each in (() if known is None else known.writer_groups) if each.writer_group_id == group]
        return found[0].data_set_writers if found else ()

    def further_state(self, number: int, component: Component) -> Live:
        """The state of a component on the connection with this number: what is switched, is so on all."""
        return Live(lambda: self._shown_state(component, number))

    def further_diagnostics(self, number: int, key: str) -> Diagnostics | None:
        """What is counted of the connection with this number itself; its NodeIds begin with `key`."""
        return self.told(CONNECTION, number, key)

    def reset_further(self, number: int, key: str) -> bool:
        """Begin to count it anew; False where nothing is counted."""
        return self.told.reset(CONNECTION, number, key)

    def describe_data_set(self, topic: Topic) -> Description:
        """See ShownConnection."""
        return describe_data_set(lambda: self._metadata(topic) or NO_METADATA, None)

    def _shown_state(self, component: Component, number: int) -> Shown:
        state = self.state(component)
        if component == CONNECTION and state is PubSubState.OPERATIONAL and self.told.has_problem(number):
            state = PubSubState.ERROR
        is_known = self._is_heard() or (self.is_muted and self._answers)
        return Shown(int(state), 0 if is_known else _NO_COMMUNICATION)

    def _take_connection(self, connection: PubSubConnection) -> None:
        groups = connection.writer_groups[:MOST_GROUPS]
        self._connection = connection._replace(writer_groups=(), reader_groups=())
        self._groups = {each.writer_group_id: each._replace(data_set_writers=()) for each in groups}
        if not groups or any(each.data_set_writers for each in groups):
            self._writers = {number: {} for number in self._groups}
            for each in groups:
                self._add_writers(each)
        else:  # they did not fit into one message
            self._writers = {number: self._writers.get(number, {}) for number in self._groups}

    def _take_writers(self, announcement: WriterConfigurationAnnouncement) -> None:
        if self._connection is None:
            return  # its PubSubConnection is asked for
        group = announcement.writer_group
        number = group.writer_group_id
        if not number:  # of DataSetWriters that it does not have
            return
        if number not in self._groups and len(self._groups) >= MOST_GROUPS:
            return
        self._groups[number] = group._replace(data_set_writers=())
        writers = self._writers.setdefault(number, {})
        self._add_writers(group)
        told: Any = zip(announcement.data_set_writer_ids, announcement.statuses, strict=False)
        for writer_id, status in told:
            if quality_of(status) is Quality.BAD:
                writers.pop(writer_id, None)

    def _add_writers(self, group: WriterGroup) -> None:
        """Take the DataSetWriters of a group that is known, as far as there is room."""
        writers = self._writers[group.writer_group_id]
        room = MOST_WRITERS - sum(map(len, self._writers.values()))
        for each in group.data_set_writers:
            if each.data_set_writer_id not in writers:
                if room <= 0:
                    continue
                room -= 1
            writers[each.data_set_writer_id] = each
