"""What a Publisher announces: answers to every probe, its status, its writers and its Actions."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Writing, decoded
from ua_fleet.counters import Counters
from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub import Application, Publisher, PubSubTiming, describe, make_field
from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, StatusCode
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionResponderAnnouncement,
    ActionTarget,
    ApplicationAnnouncement,
    ApplicationDescription,
    ConnectionsAnnouncement,
    EndpointDescription,
    EndpointsAnnouncement,
    NetworkAddressUrl,
    PubSubState,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import MetaDataAnnouncement, Probe, ProbeKind, PublisherIdType

U16 = PublisherIdType.UINT16
ACTION = Topic(1, 2, 77)
TARGETS = (ActionTarget(1, "arm"), ActionTarget(2, "gripper"))
REQUEST = (make_field("x", BuiltinType.DOUBLE),)
RESPONSE = (make_field("accepted", BuiltinType.BOOLEAN),)
ENDPOINT = EndpointDescription("opc.tcp://a", ApplicationDescription("urn:a"), None, 1, None)
SECURED = Application(
    describe("urn:cell", "cell"),
    url="opc.udp://224.0.2.14:4840",
    network_interface="eth0",
    security_mode=3,
    data_group="t-1",
    command_group="c-1",
)


def probe(kind: ProbeKind, *writer_ids: int, **changes: Any) -> Probe:
    return Probe(1, U16, kind, writer_ids, **changes)


def publishing(application: Application = SECURED) -> Writing:
    writing = Writing()
    writing.publisher = Publisher(1, writing.timing, writing.counters, CODEC, application)
    return writing


def announce_action(writing: Writing, **changes: Any) -> list[Any]:
    arguments: dict[str, Any] = {"topic": ACTION, "name": "move", "targets": TARGETS, "wall_ticks": WALL}
    arguments |= {"request": REQUEST, "response": RESPONSE, "now": writing.now} | changes
    return actions(writing.publisher.announce_action(**arguments))


def actions(datagrams: list[bytes]) -> list[ActionMetaDataAnnouncement]:
    return [message for message in decoded(datagrams) if isinstance(message, ActionMetaDataAnnouncement)]


def answer(writing: Writing, asked: Probe) -> list[Any]:
    return decoded(writing.publisher.answer(asked, writing.now))


def test_who_finds_applications_learns_who_and_how_this_is() -> None:
    writing = publishing()
    who, how = decoded(writing.publisher.begin(now=100.0, wall_ticks=WALL))
    assert who == ApplicationAnnouncement(1, U16, 0, SECURED.description)
    assert how == StatusAnnouncement(1, U16, 1, True, PubSubState.OPERATIONAL, WALL + 10 * TICKS_PER_SECOND, WALL)
    writing.now = 103.0
    who, how = answer(writing, Probe(None, PublisherIdType.STRING, ProbeKind.FIND_APPLICATIONS))
    assert who == ApplicationAnnouncement(1, U16, 2, SECURED.description)
    assert how.timestamp == WALL + 3 * TICKS_PER_SECOND
    assert how.next_report_time == WALL + 13 * TICKS_PER_SECOND, "a probe does not delay what is cyclic"


def test_the_status_comes_when_the_one_before_said_and_ends_in_order() -> None:
    writing = publishing()
    writing.publisher.begin(now=100.0, wall_ticks=WALL)
    states: list[StatusAnnouncement] = []
    for time, datagrams in writing.run_until(150.0):
        for message in decoded(datagrams):
            if isinstance(message, StatusAnnouncement):
                assert message.timestamp == WALL + round((time - 100.0) * TICKS_PER_SECOND)
                states.append(message)
    assert [state.timestamp for state in states[1:]] == [state.next_report_time for state in states[:-1]]
    assert len(states) == 5
    [last] = decoded(writing.publisher.end())
    assert (last.is_cyclic, last.state, last.next_report_time) == (False, PubSubState.DISABLED, None)
    assert writing.publisher.end() == []
    assert [message for _, datagrams in writing.run_until(300.0) for message in decoded(datagrams)] == []


def test_a_clock_that_is_set_shows_in_the_next_status() -> None:
    writing = publishing()
    writing.publisher.begin(now=100.0, wall_ticks=WALL)
    [status] = decoded(writing.publisher.poll(110.0, WALL * 2))
    assert status.timestamp == WALL * 2


def test_endpoints_of_a_process_with_a_server_and_of_one_without() -> None:
    writing = publishing()
    assert answer(writing, probe(ProbeKind.ENDPOINTS)) == [
        EndpointsAnnouncement(1, U16, 0, (), StatusCode.BAD_NOT_SUPPORTED)
    ]
    writing.publisher.describe(Application(SECURED.description, endpoints=(ENDPOINT,)))
    writing.now += 1.0
    assert answer(writing, probe(ProbeKind.ENDPOINTS)) == [EndpointsAnnouncement(1, U16, 1, (ENDPOINT,))]


def test_configuration_of_writers() -> None:
    writing = publishing()
    for number, ns in ((5, 2), (6, 2), (7, 3)):
        writing.announce(Topic(1, ns, number), name=f"source {number}")
    answers = answer(writing, probe(ProbeKind.DATA_SET_WRITER_CONFIGURATION, 5, 6, 7, 99))
    found = {found.writer_group.writer_group_id: found for found in answers}
    assert all(isinstance(found, WriterConfigurationAnnouncement) for found in answers)
    assert [found[ns].data_set_writer_ids for ns in (2, 3, 0)] == [(5, 6), (7,), (99,)]
    assert [found[ns].statuses for ns in (2, 3, 0)] == [(0, 0), (0,), (StatusCode.BAD_NOT_FOUND,)]
    group = found[2].writer_group
    assert (group.security_mode, group.security_group_id, group.keep_alive_time_ms) == (3, "t-1", 1000.0)
    assert group.message_settings is not None
    assert [writer.data_set_name for writer in group.data_set_writers] == ["source 5", "source 6"]
    assert found[0].writer_group.data_set_writers == ()


def test_configuration_of_all_writers_fits_frames() -> None:
    writing = publishing()
    for number in range(1, 101):
        writing.announce(Topic(1, 2, number), name=f"/cell/robot_{number}/joint_states")
    datagrams = writing.publisher.answer(probe(ProbeKind.DATA_SET_WRITER_CONFIGURATION), writing.now)
    assert len(datagrams) == 10
    assert max(map(len, datagrams)) < 1472
    ids = [writer_id for found in decoded(datagrams) for writer_id in found.data_set_writer_ids]
    assert ids == list(range(1, 101))


def test_configuration_of_very_many_writers_is_paced_and_all_of_it_comes() -> None:
    writing = publishing()
    for number in range(1, 5001):
        writing.announce(Topic(1, 2, number))
    writing.now = 110.0
    at_once = writing.publisher.answer(probe(ProbeKind.DATA_SET_WRITER_CONFIGURATION), writing.now)
    assert sum(len(datagram) + 512 for datagram in at_once) < 128 * 1024, "no more than a small receive buffer holds"
    found = decoded(at_once) + [message for _, datagrams in writing.run_until(110.5) for message in decoded(datagrams)]
    ids = [
        writer_id
        for message in found
        if isinstance(message, WriterConfigurationAnnouncement)
        for writer_id in message.data_set_writer_ids
    ]
    assert sorted(ids) == list(range(1, 5001))


def test_configuration_of_writer_groups() -> None:
    writing = publishing()
    writing.announce(Topic(1, 2, 5))
    writing.announce(Topic(1, 3, 6))
    asked = probe(ProbeKind.WRITER_GROUP_CONFIGURATION, writer_group_id=2)
    [group] = answer(writing, asked)
    assert (group.data_set_writer_ids, group.writer_group.data_set_writers) == ((), ())
    assert group.writer_group.writer_group_id == 2
    writing.now += 1.0
    [group] = answer(writing, asked._replace(include_data_set_writers=True))
    assert group.data_set_writer_ids == (5,)
    writing.now += 1.0
    assert len(answer(writing, asked._replace(writer_group_id=0))) == 2
    assert answer(writing, asked._replace(writer_group_id=9)) == []


@pytest.mark.parametrize(("with_groups", "with_writers"), [(False, True), (True, False), (True, True)])
def test_connections(with_groups: bool, with_writers: bool) -> None:
    writing = publishing()
    writing.announce()
    asked = probe(
        ProbeKind.PUBSUB_CONNECTIONS, include_writer_groups=with_groups, include_data_set_writers=with_writers
    )
    assert answer(writing, asked._replace(transport_profile_uris=("mqtt",))) == []
    [found] = answer(writing, asked._replace(transport_profile_uris=("mqtt", UDP)))
    assert isinstance(found, ConnectionsAnnouncement)
    [connection] = found.connections
    assert (connection.name, connection.publisher_id, connection.transport_profile_uri) == ("cell", (5, 1), UDP)
    assert connection.address == NetworkAddressUrl("eth0", "opc.udp://224.0.2.14:4840")
    assert len(connection.writer_groups) == with_groups
    for group in connection.writer_groups:
        assert len(group.data_set_writers) == with_writers


UDP = "http://opcfoundation.org/UA-Profile/Transport/pubsub-udp-uadp"


def test_connections_too_large_for_a_message_come_without_writers() -> None:
    writing = publishing()
    for number in range(1, 1000):
        writing.announce(Topic(1, 2, number), name="a" * 100)
    asked = probe(ProbeKind.PUBSUB_CONNECTIONS, include_writer_groups=True, include_data_set_writers=True)
    [found] = [message for message in answer(writing, asked) if isinstance(message, ConnectionsAnnouncement)]
    assert [group.data_set_writers for group in found.connections[0].writer_groups] == [()]


def test_actions_are_announced_repeated_and_answered() -> None:
    writing = publishing()
    writing.publisher.begin(now=writing.now, wall_ticks=WALL)
    [action] = announce_action(writing)
    assert isinstance(action, ActionMetaDataAnnouncement)
    assert (action.data_set_writer_id, action.targets, action.request.name) == (77, TARGETS, "move")
    assert (action.request.fields, action.response.fields) == (REQUEST, RESPONSE)
    assert action.request.configuration_version == action.response.configuration_version
    heard = [message for _, datagrams in writing.run_until(170.0) for message in decoded(datagrams)]
    assert not [message for message in heard if isinstance(message, ActionResponderAnnouncement)], "nobody has asked"
    [again] = [message for message in heard if isinstance(message, ActionMetaDataAnnouncement)]
    assert again._replace(sequence_number=action.sequence_number) == action
    for asked in (probe(ProbeKind.DATA_SET_META_DATA, 77), probe(ProbeKind.DATA_SET_META_DATA)):
        writing.now += 1.0
        [found] = answer(writing, asked)
        assert found._replace(sequence_number=0) == action._replace(sequence_number=0)
    writing.now += 1.0
    asked = probe(ProbeKind.PUBSUB_CONNECTIONS, include_writer_groups=True, include_data_set_writers=True)
    connections, responder = answer(writing, asked)
    assert isinstance(connections, ConnectionsAnnouncement)
    assert isinstance(responder, ActionResponderAnnouncement)
    [group] = responder.connections[0].writer_groups
    assert (group.writer_group_id, group.security_group_id) == (2, "c-1")
    assert [writer.data_set_writer_id for writer in group.data_set_writers] == [77]


def test_versions_of_actions() -> None:
    writing = publishing()
    versions: list[tuple[int, int]] = []
    changes: list[dict[str, Any]] = [
        {},
        {},
        {"targets": TARGETS[:1]},
        {"name": "drive"},
        {"request": FIELDS},
        {"request": FIELDS, "response": ()},
    ]
    for change in changes:
        writing.now += 1.0
        [action] = announce_action(writing, **change)
        versions.append(action.request.configuration_version)
    majors, minors = zip(*versions, strict=True)
    assert versions[0] == versions[1]
    assert majors[1] == majors[2] == majors[3], "it says which fields there are"
    assert len({majors[3], majors[4], majors[5]}) == 3
    assert minors[1] < minors[2] < minors[3] < minors[4] < minors[5]
    again = publishing()
    again.now += 50.0
    [action] = announce_action(again, request=FIELDS)
    assert action.request.configuration_version.major == majors[4], "also after a restart"


def test_a_retired_action_has_no_targets_and_no_responder() -> None:
    writing = publishing()
    [before] = announce_action(writing)
    writing.now += 1.0
    [action] = actions(writing.publisher.retire_action(ACTION, now=writing.now, wall_ticks=WALL))
    assert action.targets == ()
    assert action.request.configuration_version.minor > before.request.configuration_version.minor
    assert writing.publisher.retire_action(ACTION, now=writing.now, wall_ticks=WALL) == []
    assert writing.publisher.retire_action(Topic(1, 2, 3), now=writing.now, wall_ticks=WALL) == []
    writing.now += 1.0
    [found] = answer(writing, probe(ProbeKind.DATA_SET_META_DATA, 77))
    assert found.targets == (), "who missed it learns it"
    asked = probe(ProbeKind.PUBSUB_CONNECTIONS, include_writer_groups=True)
    [_, responder] = answer(writing, asked)
    assert responder.connections[0].writer_groups == ()
    writing.now += 1.0
    [back] = announce_action(writing)
    assert back.targets == TARGETS


@pytest.mark.parametrize(
    "change",
    [
        {"topic": Topic(2, 2, 77)},
        {"topic": TOPIC},
        {"request": (make_field("x", BuiltinType.NULL),)},
        {"targets": (ActionTarget(70_000, "a"),)},
        {"name": "a" * 70_000},
    ],
)
def test_actions_that_cannot_be_announced(change: dict[str, Any]) -> None:
    writing = publishing()
    writing.announce()
    with pytest.raises(LocalWireError):
        announce_action(writing, **change)
    assert [type(found) for found in answer(writing, probe(ProbeKind.PUBSUB_CONNECTIONS))] == [ConnectionsAnnouncement]


def test_writers_that_there_are_not_are_denied() -> None:
    writing = publishing()
    writing.announce()
    announce_action(writing)
    writing.now += 1.0
    found = answer(writing, probe(ProbeKind.DATA_SET_META_DATA, 9, 10, 77))
    denied = [message for message in found if isinstance(message, MetaDataAnnouncement)]
    assert [(message.data_set_writer_id, message.status) for message in denied] == [
        (9, StatusCode.BAD_NOT_FOUND),
        (10, StatusCode.BAD_NOT_FOUND),
    ]
    assert sum(isinstance(message, ActionMetaDataAnnouncement) for message in found) == 1


def test_what_changes_is_said_soon_and_together() -> None:
    writing = publishing()
    writing.publisher.begin(now=writing.now, wall_ticks=WALL)
    for number in (5, 6, 7):
        writing.announce(Topic(1, 2, number))
    writing.announce(Topic(1, 2, 7))

    def said(end: float) -> list[tuple[float, tuple[int, ...], tuple[int, ...]]]:
        return [
            (time, message.data_set_writer_ids, message.statuses)
            for time, datagrams in writing.run_until(end)
            for message in decoded(datagrams)
            if isinstance(message, WriterConfigurationAnnouncement)
        ]

    assert said(120.0) == [(100.5, (5, 6, 7), (0, 0, 0))]
    writing.publisher.retire(Topic(1, 2, 6))
    writing.announce(Topic(1, 2, 5), name="other")
    assert [part[1:] for part in said(130.0)] == [((6, 5), (StatusCode.BAD_NOT_FOUND, 0))]


ALL_KINDS = [kind for kind in ProbeKind if kind is not ProbeKind.DATA_SET_META_DATA]


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_many_who_ask_at_once_get_one_answer(kind: ProbeKind) -> None:
    writing = publishing()
    writing.announce()
    announce_action(writing)
    writing.now += 10.0
    writing.publisher.poll(writing.now)
    writing.now += 10.0
    asked = probe(kind, include_writer_groups=True, include_data_set_writers=True)
    once = [message.__class__ for message in answer(writing, asked)]
    assert once
    later: Counter[Any] = Counter()
    for step in range(1, 201):  # a thousand probes within a second
        writing.now += 0.005
        for _ in range(5):
            later.update(message.__class__ for message in answer(writing, asked))
        if step % 10 == 0:
            later.update(message.__class__ for message in decoded(writing.publisher.poll(writing.now)))
    for what in once:
        assert later[what] <= 2 * once.count(what), "one each half second"


def test_a_flood_of_probes_for_what_there_is_not_gets_few_answers() -> None:
    publisher = Publisher(1, PubSubTiming(), Counters(), CODEC)
    sent = 0
    for step in range(100):
        ids = tuple(range(step * 600 + 1, step * 600 + 601))
        sent += len(publisher.answer(probe(ProbeKind.DATA_SET_META_DATA, *ids), 100.0 + step * 0.01))
        sent += len(publisher.answer(probe(ProbeKind.DATA_SET_WRITER_CONFIGURATION, *ids[:20]), 100.0 + step * 0.01))
    assert sent < 60


def test_sequence_numbers_of_all_announcements_are_one_row() -> None:
    writing = publishing()
    datagrams = writing.publisher.begin(now=100.0, wall_ticks=WALL) + writing.announce()
    writing.now += 1.0
    for kind in ProbeKind:
        datagrams += writing.publisher.answer(probe(kind), writing.now)
    announced = [message for message in decoded(datagrams) if not hasattr(message, "messages")]
    assert [message.sequence_number for message in announced] == list(range(len(announced)))
