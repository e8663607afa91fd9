"""The PubSubConnection of the server itself, as its information model shows it. Pure: it looks when it is asked."""

from __future__ import annotations

from collections import Counter as Count
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Final, Protocol

from ua_fleet.fleet.matching import find_field
from ua_fleet.fleet.source import Source
from ua_fleet.operation.pubsub.description import (
    ADVANCED,
    Counter,
    Description,
    Diagnostics,
    Live,
    Shown,
    describe_connection,
    describe_data_set,
    describe_reader,
    describe_reader_group,
    describe_writer,
    describe_writer_group,
    small_counts,
)
from ua_fleet.operation.pubsub.difference import Part
from ua_fleet.pubsub.components import (
    CONNECTION,
    Component,
    Components,
    reader,
    reader_group,
    writer,
    writer_group,
)
from ua_fleet.pubsub.group_figures import LinkErrors
from ua_fleet.pubsub.layout import PLAIN, WriterSettings
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import NodeId, StatusCode, Variant
from ua_fleet.wire.discovered import DataSetReader, DataSetWriter, PubSubConnection, PubSubState
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData

__all__ = ["Resets", "ServerConnection", "ServerFacts", "ShownConnection", "state_counters"]

NO_METADATA: Final = DataSetMetaData("", (), ConfigurationVersion(0, 0))
_UNKNOWN: Final = Shown(None, int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA))
_NOTHING: Final = 0
MOST_STRANGERS: Final = 64
"""PublisherIds without a bridge that have a ReaderGroup: anybody could send under any number of them."""


class ShownConnection(Protocol):
    """One PubSubConnection with what is below it, as `nodes.pubsub_nodes` shows it."""

    key: str
    """What the NodeIds begin with."""
    has_data_sets: bool
    """Whether it has PublishedDataSets of its own."""

    def connection(self) -> Part | None:
        """The PubSubConnection; None while nothing is known of it."""
        ...

    def groups(self) -> Mapping[Component, Part]:
        """Its WriterGroups and ReaderGroups."""
        ...

    def members(self, group: Component) -> Mapping[Component, Part]:
        """The DataSetWriters or DataSetReaders of a group."""
        ...

    def data_sets(self) -> Mapping[Topic, Part]:
        """Its PublishedDataSets."""
        ...

    def writers_of(self, topic: Topic) -> Iterable[Component]:
        """The DataSetWriters of a PublishedDataSet."""
        ...

    def describe(self, component: Component) -> Description:
        """What a component shows."""
        ...

    def describe_data_set(self, topic: Topic) -> Description:
        """What a PublishedDataSet shows."""
        ...


class Resets:
    """What counters were when somebody called Reset, of those that were reset."""

    def __init__(self) -> None:
        self._before: dict[tuple[str, Component], dict[str, int]] = {}

    def counters(self, connection: str, component: Component, counters: Mapping[str, Counter]) -> dict[str, Counter]:
        """The same counters, from the last Reset on."""
        key = connection, component

        def since(name: str, count: Callable[[], int]) -> int:
            return count() - self._before.get(key, {}).get(name, 0)

        return {
            name: Counter(partial(since, name, each.count), each.is_error, each.level)
            for name, each in counters.items()
        }

    def errors(self, connection: str, component: Component) -> int:
        """How many errors of a DataSetWriter or DataSetReader were counted before the last Reset."""
        before = self._before.get((connection, component), {})
        return before.get("FailedDataSetMessages", 0) + before.get("StateError", 0)

    def reset(self, connection: str, component: Component, counters: Mapping[str, Counter]) -> None:
        """Begin anew with these, which are as `counters` gives them."""
        before = self._before.setdefault((connection, component), {})
        for name, each in counters.items():
            before[name] = before.get(name, 0) + each.count()


def state_counters(
    components: Components, component: Component, *, errors: Callable[[], tuple[int, int]] = lambda: (0, 0)
) -> dict[str, Counter]:
    """The counters that all Diagnostics Objects have (9.1.11.2).

    Args:
        components: of its PubSubConnection.
        component: which one.
        errors: how often it went into the state Error, and back from there.
    """

    def counted(name: str) -> Counter:
        return Counter(lambda: int(getattr(components.counts(component), name)))

    return {
        "StateError": Counter(lambda: errors()[0], is_error=True),
        "StateOperationalByMethod": counted("operational_by_method"),
        "StateOperationalByParent": counted("operational_by_parent"),
        "StateOperationalFromError": Counter(lambda: errors()[1]),
        "StatePausedByParent": counted("paused_by_parent"),
        "StateDisabledByMethod": counted("disabled_by_method"),
    }


@dataclass(frozen=True, slots=True)
class ServerFacts:
    """What a server's PubSubConnection is made of."""

    publisher: Publisher
    subscriber: Subscriber
    sources: Callable[[], Iterable[Source]]
    """The sources that have nodes."""
    source: Callable[[Topic], Source | None]
    """One of them."""
    publishers: Mapping[int, str]
    """Spaces that are read, with the names of their bridges."""
    publisher_id: Callable[[int], Variant]
    """The PublisherId of a space on the wire."""
    settings: Mapping[Topic, WriterSettings]
    receive_timeout_s: float
    security_mode: int
    security_group: Callable[[int], str | None]
    """The SecurityGroup of what a space sends."""
    failed: Count[int]
    """NetworkMessages that could not be sent, by WriterGroupId."""
    not_secured: Count[int]
    """NetworkMessages that could not be signed or encrypted, by WriterGroupId."""
    problems: Callable[[], Sequence[str]]
    """Why nothing can be sent or received now by each of its connections; empty where all is well."""
    address: Callable[[int, int], Any]
    """Where the messages of a space go by the connection of its process with a number."""


class ServerConnection:
    """See ShownConnection."""

    key = "PubSub.server"
    has_data_sets = True

    def __init__(self, facts: ServerFacts, resets: Resets) -> None:
        """Show a server's PubSubConnection."""
        self._facts, self._resets = facts, resets
        self._publisher, self._subscriber = facts.publisher, facts.subscriber
        self.components = self._publisher.switches.components
        """The switches of what it sends; those of what it takes are the subscriber's."""
        self._errors = [LinkErrors() for _ in facts.problems()]

    def look(self) -> None:
        """Note which transports work: a change is counted. To be called each second."""
        for errors, problem in zip(self._errors, self._facts.problems(), strict=True):
            errors.look(problem)

    def of(self, component: Component) -> Components:
        """The switches that a component belongs to."""
        return self._subscriber.components if component[:1] == ("R",) else self.components

    def connection(self) -> Part:
        """See ShownConnection."""
        made = self._publisher.configuration()
        return Part(made.name or "server", made._replace(enabled=True, writer_groups=()))

    def groups(self) -> dict[Component, Part]:
        """See ShownConnection."""
        groups: dict[Component, Part] = {
            writer_group(each.writer_group_id): Part(each.name or "", each._replace(enabled=True))
            for each in self._publisher.configuration().writer_groups
        }
        for space in sorted({*self._facts.publishers, *self._strangers()}):
            name = self._facts.publishers.get(space) or f"space-{space}"
            groups[reader_group(space)] = Part(f"readers-{name}", space)
        return groups

    def _strangers(self) -> Iterable[int]:
        """Those that were heard first stay, so that their nodes do."""
        heard = self._subscriber.received_messages
        return islice((space for space in heard if space not in self._facts.publishers), MOST_STRANGERS)

    def members(self, group: Component) -> dict[Component, Part]:
        """See ShownConnection."""
        number = int(group[1])
        if group[0] == "W":
            return {
                writer(number, each.data_set_writer_id): Part(each.name or "", each._replace(enabled=True))
                for each in self._publisher.group(number).data_set_writers
            }
        return {reader(topic): Part(topic.name, topic) for topic in self._readers(number)}

    def data_sets(self) -> dict[Topic, Part]:
        """See ShownConnection."""
        found: dict[Topic, Part] = {}
        for topic, each in self._publisher.writers.items():
            if each.encode is not None:
                names = self._publisher.names_of(topic[2])  # its metadata may have the name of another's
                found[Topic(*topic)] = Part(each.metadata.name if names is None else names[1], None)
        return found

    def writers_of(self, topic: Topic) -> list[Component]:
        """See ShownConnection."""
        return [writer(topic.ns, topic.id)]

    def describe(self, component: Component) -> Description:
        """See ShownConnection."""
        if component == CONNECTION:
            return describe_connection(
                self._publisher.configuration(),
                self.further_state(0, component),
                self.diagnostics(component),
                can_switch=True,
            )
        state = Live.plain(lambda: int(self.of(component).state(component)))
        if component[0] == "W":
            group = self._publisher.group(int(component[1]))
            if component == writer_group(group.writer_group_id):
                return describe_writer_group(group, state, self.diagnostics(component), can_switch=True)
            [own] = [each for each in group.data_set_writers if each.data_set_writer_id == component[2]]
            return describe_writer(own, state, self.diagnostics(component), can_switch=True)
        space = int(component[1])
        mode, security_group = self._facts.security_mode, self._facts.security_group(space)
        if component == reader_group(space):
            return describe_reader_group(mode, security_group, state, self.diagnostics(component))
        return self._describe_reader(Topic(*[int(number) for number in component[1:]]))

    def further(self, number: int) -> PubSubConnection:
        """The connection with this number, from 1 on."""
        return self._publisher.configuration(number)

    def further_writers(self, number: int, group: int) -> tuple[DataSetWriter, ...]:
        """The DataSetWriters of a group as they are on the connection with this number."""
        return self._publisher.group(group, number).data_set_writers

    def further_state(self, number: int, component: Component) -> Live:
        """The state of a component on the connection with this number: what is switched, is so on all."""

        def state() -> int:
            found = self.components.state(component)
            may_fail = component == CONNECTION and found is PubSubState.OPERATIONAL
            return int(PubSubState.ERROR if may_fail and self._facts.problems()[number] else found)

        return Live.plain(state)

    def further_diagnostics(self, number: int, key: str) -> Diagnostics:
        """What is counted of the connection with this number itself; its NodeIds begin with `key`."""
        counters, live = self._counted_connection(number)
        return Diagnostics(self._resets.counters(key, CONNECTION, counters), live)

    def reset_further(self, number: int, key: str) -> bool:
        """Begin to count it anew; it is always counted."""
        self._resets.reset(key, CONNECTION, self.further_diagnostics(number, key).counters)
        return True

    def describe_data_set(self, topic: Topic) -> Description:
        """See ShownConnection."""
        known, source = self._publisher.writers[topic], self._facts.source(topic)
        if source is None:  # what it says is the value of no Variable
            return describe_data_set(lambda: known.metadata, None)
        variables = [field.key for field in source.model.fields]
        return describe_data_set(lambda: known.metadata, lambda: variables)

    def diagnostics(self, component: Component) -> Diagnostics:
        """What is counted of a component."""
        counters, live = self._counted(component)
        children = partial(self._has_failed, component)
        return Diagnostics(self._resets.counters(self.key, component, counters), live, children)

    def reset(self, component: Component) -> None:
        """Begin to count anew."""
        self._resets.reset(self.key, component, self.diagnostics(component).counters)

    def configured(self, group: Component | None = None) -> int:
        """DataSetWriters, or DataSetReaders, of a group; of all WriterGroups where there is none."""
        if group is not None and group[0] == "R":
            return len(self._readers(int(group[1])))
        return sum(each.encode is not None and self._is_in(group, topic) for topic, each in self._written())

    def operational(self, group: Component | None = None) -> int:
        """Those of them that are Operational."""
        if group is not None and group[0] == "R":
            return sum(self.reader_state(topic) is PubSubState.OPERATIONAL for topic in self._readers(int(group[1])))
        return sum(
            each.encode is not None and not each.is_off and self._is_in(group, topic) for topic, each in self._written()
        )

    def all_readers(self) -> tuple[int, int]:
        """How many DataSetReaders there are, and how many of them are Operational."""
        heard = {writer.topic for writer in self._subscriber.writers.values()}
        shown = {each.model.topic for each in self._facts.sources()}
        topics = [topic for topic in heard | shown if topic.space != SERVER_SPACE]
        return len(topics), sum(self.reader_state(topic) is PubSubState.OPERATIONAL for topic in topics)

    def reader_state(self, topic: Topic) -> PubSubState:
        """The state of a DataSetReader: PreOperational until it can read, Error while nothing comes (6.2.9.6)."""
        state = self._subscriber.components.state(reader(topic))
        if state is not PubSubState.OPERATIONAL:
            return state
        known = self._subscriber.writers.get(topic)
        if known is None or known.metadata is None:
            return PubSubState.PRE_OPERATIONAL
        return PubSubState.ERROR if known.silent else PubSubState.OPERATIONAL

    @staticmethod
    def _is_in(group: Component | None, topic: Topic) -> bool:
        return group is None or group == writer_group(topic[1])

    def _written(self) -> Iterable[tuple[Any, Any]]:
        return self._publisher.writers.items()

    def _readers(self, space: int) -> list[Topic]:
        """What is read of a space: sources with nodes, and what was heard besides."""
        heard = [writer.topic for writer in self._subscriber.writers.values() if writer.topic.space == space]
        shown = [each.model.topic for each in self._facts.sources() if each.model.topic.space == space]
        return sorted({*heard, *shown}) if space != SERVER_SPACE else []

    def _counted(self, component: Component) -> tuple[dict[str, Counter], dict[str, Callable[[], Any]]]:
        """The counters of a component since the start, and its live values."""
        facts = self._facts
        if component == CONNECTION:
            return self._counted_connection(0)
        counters = state_counters(self.of(component), component)
        number = int(component[1])
        if component == writer_group(number):
            counters |= {
                "SentNetworkMessages": Counter(lambda: self._publisher.sent_messages[number]),
                "FailedTransmissions": Counter(lambda: facts.failed[number], is_error=True),
                "EncryptionErrors": Counter(lambda: facts.not_secured[number], is_error=True, level=ADVANCED),
            }
            return counters, small_counts(
                partial(self.configured, component), partial(self.operational, component), "DataSetWriters"
            )
        if component == reader_group(number):
            received, refused = self._subscriber.received_messages, self._subscriber.refused_messages
            counters |= {
                "ReceivedNetworkMessages": Counter(lambda: received[number]),
                "DecryptionErrors": Counter(lambda: refused[number], is_error=True, level=ADVANCED),
            }
            return counters, small_counts(
                partial(self.configured, component), partial(self.operational, component), "DataSetReaders"
            )
        if component[0] == "W":
            own = self._publisher.writers[SERVER_SPACE, number, int(component[2])]
            counters["FailedDataSetMessages"] = Counter(lambda: own.failed, is_error=True)
            return counters, {
                "MessageSequenceNumber": lambda: (own.next_number - 1) & MASK if own.timestamp >= 0 else _UNKNOWN,
                "StatusCode": lambda: own.status,
                "MajorVersion": lambda: own.metadata.configuration_version.major,
                "MinorVersion": lambda: own.metadata.configuration_version.minor,
            }
        return self._counted_reader(Topic(*[int(each) for each in component[1:]]))

    def _counted_connection(self, number: int) -> tuple[dict[str, Counter], dict[str, Callable[[], Any]]]:
        errors = self._errors[number]
        return state_counters(self.components, CONNECTION, errors=lambda: errors.counts), {
            "ResolvedAddress": partial(self._facts.address, SERVER_SPACE, number)
        }

    def _counted_reader(self, topic: Topic) -> tuple[dict[str, Counter], dict[str, Callable[[], Any]]]:
        def known() -> RemoteWriter | None:
            return self._subscriber.writers.get(topic)

        def errors() -> tuple[int, int]:
            heard = known()
            return (0, 0) if heard is None else (heard.silences, heard.silences - heard.silent)

        def of_version(name: str) -> Any:
            heard = known()
            metadata = None if heard is None else heard.metadata
            return _UNKNOWN if metadata is None else getattr(metadata.configuration_version, name)

        def number() -> Any:
            heard = known()
            return _UNKNOWN if heard is None or heard.expected is None else (heard.expected - 1) & MASK

        def status() -> Any:
            heard = known()
            frame = None if heard is None else heard.last_frame
            return _UNKNOWN if frame is None else frame.status or 0

        counters = state_counters(self._subscriber.components, reader(topic), errors=errors)
        counters["FailedDataSetMessages"] = Counter(
            lambda: _NOTHING if (heard := known()) is None else heard.failed, is_error=True
        )
        return counters, {
            "MessageSequenceNumber": number,
            "StatusCode": status,
            "MajorVersion": partial(of_version, "major"),
            "MinorVersion": partial(of_version, "minor"),
        }

    def _describe_reader(self, topic: Topic) -> Description:
        def metadata() -> DataSetMetaData:
            known = self._subscriber.writers.get(topic)
            return NO_METADATA if known is None or known.metadata is None else known.metadata

        def targets() -> Iterable[tuple[Any, NodeId]]:
            source, fields = self._facts.source(topic), metadata().fields
            if source is None:
                return []
            model = source.model
            found = [(find_field(fields, each.name, each.path, is_only=model.is_single), each) for each in model.fields]
            return [(fields[index].data_set_field_id, each.key) for index, each in found if index is not None]

        settings = self._facts.settings.get(topic, PLAIN)
        configured = DataSetReader(
            topic.name,
            True,
            self._facts.publisher_id(topic.space),
            topic.ns,
            topic.id,
            NO_METADATA,
            message_receive_timeout_ms=self._facts.receive_timeout_s * 1000.0,
            key_frame_count=0 if settings.are_events else settings.key_frame_count,
        )
        state = Live.plain(lambda: int(self.reader_state(topic)))
        return describe_reader(configured, metadata, targets, state, self.diagnostics(reader(topic)))

    def _has_failed(self, component: Component) -> bool:
        """Whether anything on the next layer has counted an error."""
        if len(component) > len(reader_group(0)):
            return False
        if component == CONNECTION:
            return any(self.diagnostics(each).total(errors=True) for each in self.groups())
        if component[0] == "W":
            return any(
                each.failed > self._resets.errors(self.key, writer(topic[1], topic[2]))
                for topic, each in self._written()
                if topic[1] == component[1]
            )
        return any(
            each.failed + each.silences > self._resets.errors(self.key, reader(each.topic))
            for each in self._subscriber.writers.values()
            if each.topic.space == component[1]
        )
