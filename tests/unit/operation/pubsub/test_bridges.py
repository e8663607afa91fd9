"""What is shown of a bridge follows from what it announces."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.counters import Counters
from ua_fleet.operation.pubsub.bridges import AnnouncedConnection
from ua_fleet.pubsub import Publisher, PubSubTiming, make_field
from ua_fleet.pubsub.components import CONNECTION, Component, writer, writer_group
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import (
    ConnectionsAnnouncement,
    DataSetWriter,
    PubSubState,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
    WriterGroup,
)
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

SPACE, WALL = 3, 134_000_000_000_000_000
FIELDS = (make_field("level", BuiltinType.DOUBLE),)
CODEC = Codec()
STATUS = Topic(SPACE, 2, 1900)
TOPICS = [Topic(SPACE, ns, writer_id) for ns in (2, 4) for writer_id in (1001 + ns, 1011 + ns)]


class Bridge:
    """A publisher, and what the server knows of it."""

    def __init__(self) -> None:
        self.now, self.is_heard = 100.0, True
        self.publisher = Publisher(SPACE, PubSubTiming(), Counters(), CODEC)
        self.known = AnnouncedConnection(
            "b",
            SPACE,
            metadata=self.publisher.metadata,
            is_heard=lambda: self.is_heard,
            status=STATUS,
        )
        self.publisher.begin(now=self.now, wall_ticks=WALL)

    def announce(self, topic: Topic) -> None:
        self.publisher.announce(topic, f"n{topic.id}", FIELDS, now=self.now, wall_ticks=WALL)

    def tell(self) -> None:
        """Everything that is due now is heard."""
        self.now += 2.0
        for datagram in self.publisher.poll(self.now, WALL):
            self.hear(datagram)

    def ask(self) -> None:
        """Have it announce all that it is."""
        kind = ProbeKind.PUBSUB_CONNECTIONS
        probe = Probe(SPACE, PublisherIdType.UINT16, kind, include_writer_groups=True, include_data_set_writers=True)
        for datagram in self.publisher.answer(probe, self.now):
            self.hear(datagram)
        self.tell()

    def hear(self, datagram: bytes) -> None:
        message: Any = CODEC.decode(datagram)
        if hasattr(message, "sequence_number") and not hasattr(message, "messages"):
            self.known.heard(message, self.now)

    def shown(self) -> dict[Component, str]:
        groups = self.known.groups()
        found = {group: part.name for group, part in groups.items()}
        for group in groups:
            found |= {each: part.name for each, part in self.known.members(group).items()}
        return found


def test_nothing_is_shown_until_it_is_announced() -> None:
    bridge = Bridge()
    bridge.announce(TOPICS[0])
    bridge.tell()
    assert bridge.known.connection() is None
    bridge.ask()
    part = bridge.known.connection()
    assert part is not None
    assert bridge.shown() == {writer_group(2): "group-2", writer(2, 1003): "n1003"}
    assert bridge.known.data_sets().keys() == {TOPICS[0]}
    bridge.known.forget()
    assert bridge.known.connection() is None


def test_the_states_are_those_that_the_bridge_has_said_and_not_good_while_it_is_away() -> None:
    bridge = Bridge()
    bridge.announce(TOPICS[0])
    bridge.ask()
    state = bridge.known.describe(writer(2, 1003)).values["Status.State"]
    assert state.now() == (PubSubState.OPERATIONAL, 0)
    bridge.is_heard = False
    assert state.now() == (PubSubState.OPERATIONAL, StatusCode.BAD_NO_COMMUNICATION)


def disabled_status(bridge: Bridge, component: Component) -> None:
    """Have a bridge that tells its status disable something, and be silent."""
    for topic in (STATUS, TOPICS[0], TOPICS[2]):
        bridge.announce(topic)
    bridge.ask()
    for datagram in bridge.publisher.switches.disable(component, timestamp=WALL, now=bridge.now):
        bridge.hear(datagram)
    bridge.tell()
    bridge.is_heard = False


@pytest.mark.parametrize(
    ("component", "shown"),
    [
        (CONNECTION, (PubSubState.DISABLED, PubSubState.PAUSED, PubSubState.PAUSED)),
        (writer_group(2), (PubSubState.OPERATIONAL, PubSubState.DISABLED, PubSubState.OPERATIONAL)),
        (writer(2, 1900), (PubSubState.OPERATIONAL, PubSubState.OPERATIONAL, PubSubState.OPERATIONAL)),
    ],
)
def test_a_bridge_whose_status_is_disabled_is_not_taken_for_one_that_is_gone(
    component: Component, shown: tuple[PubSubState, ...]
) -> None:
    bridge = Bridge()
    disabled_status(bridge, component)
    bridge.known.look(bridge.now)
    states = [
        bridge.known.describe(each).values["Status.State"].now()
        for each in (CONNECTION, writer_group(2), writer(4, 1005))
    ]
    assert states == [(state, 0) for state in shown]
    bridge.is_heard = True
    assert bridge.known.is_muted
    for datagram in bridge.publisher.switches.enable(component, now=bridge.now):
        bridge.hear(datagram)
    bridge.tell()
    assert not bridge.known.is_muted


def test_a_bridge_that_was_told_to_be_silent_is_gone_when_it_does_not_answer_either() -> None:
    bridge = Bridge()
    disabled_status(bridge, writer_group(2))
    state = bridge.known.describe(CONNECTION).values["Status.State"]
    bridge.known.look(bridge.now + 24.0)
    assert state.now() == (PubSubState.OPERATIONAL, 0)
    bridge.known.look(bridge.now + 26.0)
    assert state.now() == (PubSubState.OPERATIONAL, StatusCode.BAD_NO_COMMUNICATION)
    bridge.now += 100.0
    kept = ConnectionsAnnouncement(SPACE, 1, 0, (bridge.publisher.configuration(),))
    bridge.known.heard(kept, bridge.now, is_fresh=False)  # what a broker has kept may be of any time
    bridge.known.heard(StatusAnnouncement(SPACE, 1, 0, False, PubSubState.OPERATIONAL.value), bridge.now)
    bridge.known.look(bridge.now)
    assert state.now().status == StatusCode.BAD_NO_COMMUNICATION
    bridge.ask()
    bridge.known.look(bridge.now)
    assert state.now().status == 0


def test_the_will_of_a_silent_bridge_ends_it_at_once() -> None:
    bridge = Bridge()
    disabled_status(bridge, writer_group(2))
    bridge.known.heard(StatusAnnouncement(SPACE, 1, 0, False, PubSubState.ERROR.value), bridge.now)
    bridge.known.look(bridge.now)
    assert bridge.known.describe(CONNECTION).values["Status.State"].now().status == StatusCode.BAD_NO_COMMUNICATION


def test_what_is_heard_of_a_bridge_says_nothing_while_its_status_is_missing() -> None:
    """A bridge that still announces something, and does not send its status as it should, is not well."""
    bridge = Bridge()
    bridge.announce(STATUS)
    bridge.ask()
    bridge.is_heard = False
    bridge.known.look(bridge.now)
    assert bridge.known.describe(CONNECTION).values["Status.State"].now().status == StatusCode.BAD_NO_COMMUNICATION


def test_a_connection_whose_writers_do_not_fit_into_one_message_waits_for_them() -> None:
    bridge = Bridge()
    bridge.announce(TOPICS[0])
    made = bridge.publisher.configuration()
    bridge.known.heard(ConnectionsAnnouncement(SPACE, 1, 0, (made,)), bridge.now)
    assert bridge.known.lacks([TOPICS[0]])
    assert bridge.shown() == {writer_group(2): "group-2"}
    bridge.tell()
    assert not bridge.known.lacks([TOPICS[0]])
    assert writer(2, 1003) in bridge.shown()


def group_of(number: int, writers: int) -> WriterGroup:
    made = tuple(DataSetWriter(f"w{each}", True, each) for each in range(1, writers + 1))
    return WriterGroup(f"group-{number}", True, writer_group_id=number, data_set_writers=made)


def configuration_of(group: WriterGroup) -> WriterConfigurationAnnouncement:
    ids = tuple(each.data_set_writer_id for each in group.data_set_writers)
    return WriterConfigurationAnnouncement(SPACE, 1, 0, ids, group, (0,) * len(ids))


def test_whatever_is_announced_so_many_groups_and_writers_are_shown() -> None:
    bridge = Bridge()
    made = bridge.publisher.configuration()
    large = [group_of(number, 15_000) for number in (1, 2)]
    bridge.known.heard(ConnectionsAnnouncement(SPACE, 1, 0, (made._replace(writer_groups=tuple(large)),)), bridge.now)
    members = [len(bridge.known.members(writer_group(number))) for number in (1, 2)]
    assert members == [15_000, 5_000]
    bridge.known.heard(configuration_of(group_of(3, 10)), bridge.now)
    assert not bridge.known.members(writer_group(3))
    groups = tuple(group_of(number, 0) for number in range(1, 301))
    bridge.known.heard(ConnectionsAnnouncement(SPACE, 1, 0, (made._replace(writer_groups=groups),)), bridge.now)
    bridge.known.heard(configuration_of(group_of(400, 1)), bridge.now)
    bridge.known.heard(configuration_of(group_of(7, 1)), bridge.now)
    assert list(bridge.known.groups()) == [writer_group(number) for number in range(1, 257)]


STEPS = st.lists(
    st.tuples(st.sampled_from(["announce", "retire", "switch", "ask", "tell"]), st.sampled_from(TOPICS)), max_size=25
)


@given(steps=STEPS)
def test_what_is_shown_is_what_the_bridge_has_whatever_it_does(steps: list[tuple[str, Topic]]) -> None:
    bridge = Bridge()
    switches = bridge.publisher.switches
    for step, topic in steps:
        component = writer(topic.ns, topic.id)
        if step == "announce":
            bridge.announce(topic)
        elif step == "retire":
            bridge.publisher.retire(topic)
        elif step == "ask":
            bridge.ask()
        elif step == "tell":
            bridge.tell()
        elif switches.components.is_enabled(component):
            for datagram in switches.disable(component, timestamp=WALL, now=bridge.now):
                bridge.hear(datagram)
        else:
            for datagram in switches.enable(component, now=bridge.now):
                bridge.hear(datagram)
    bridge.tell()
    bridge.ask()
    written = {topic for topic, each in bridge.publisher.writers.items() if each.encode is not None}
    there = {writer(topic[1], topic[2]) for topic in written}
    shown = bridge.shown()
    assert {each for each in shown if len(each) > 2} == there
    for component in there:
        assert bridge.known.state(component) is switches.components.state(component)
