"""`ua-fleet pubsub probe` without a network: what it asks, what it takes for answers, and its tables."""

from __future__ import annotations

import asyncio

import pytest

from tests.unit.wire.discovery_samples import ANNOUNCEMENTS
from ua_fleet.cli.kind import HealthKind
from ua_fleet.cli.opening import Opener, tool_envelope
from ua_fleet.cli.probe_tables import table
from ua_fleet.cli.prober import ANSWERS, Prober
from ua_fleet.cli.pubsub_probe import nothing_heard
from ua_fleet.counters import Counters
from ua_fleet.transport.memory import MemoryNetwork
from ua_fleet.values import LocalizedText
from ua_fleet.wire import Codec, encode_announcement
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    AnyAnnouncement,
    ApplicationAnnouncement,
    ApplicationDescription,
    EndpointsAnnouncement,
    StatusAnnouncement,
)
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

U16 = PublisherIdType.UINT16.value
STATUS = StatusAnnouncement(7, U16, 0, False, 2)


def prober(kind: HealthKind, publisher_id: int | None = None) -> Prober:
    counters = Counters()
    return Prober(kind, publisher_id, Opener(counters, tool_envelope(None, counters)))


async def asked(
    kind: HealthKind, publisher_id: int | None, answers: list[AnyAnnouncement]
) -> tuple[Prober, list[Probe]]:
    """What is asked of somebody who gives these answers to the first probe."""
    network = MemoryNetwork()
    tool, other = network.endpoint(), network.endpoint()
    probes: list[Probe] = []
    codec = Codec()

    def receive(datagram: bytes, _sender: object) -> None:
        message = codec.decode(datagram)
        if isinstance(message, Probe):
            if not probes:
                for answer in answers:
                    other.send(encode_announcement(answer))
            probes.append(message)

    other.attach(receive)
    asking = prober(kind, publisher_id)
    task = asyncio.ensure_future(asking.ask(tool, None, 5.0))
    await asyncio.sleep(0)
    network.advance_to(1.0)
    await asyncio.sleep(0)
    network.advance_to(2.0)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return asking, probes


async def test_whom_it_finds_it_asks() -> None:
    asking, probes = await asked(HealthKind.ENDPOINTS, None, [STATUS, STATUS._replace(publisher_id=8)])
    assert asking.answers == []
    assert asking.found == {7, 8}
    assert probes[0].kind == ProbeKind.FIND_APPLICATIONS
    assert {(probe.publisher_id, probe.kind) for probe in probes[1:]} == {
        (7, ProbeKind.ENDPOINTS),
        (8, ProbeKind.ENDPOINTS),
    }


async def test_answers_are_those_of_who_was_asked_each_once() -> None:
    answer = EndpointsAnnouncement(7, U16, 3, ())
    others: list[AnyAnnouncement] = [STATUS, answer._replace(sequence_number=4), answer._replace(publisher_id=8)]
    asking, probes = await asked(HealthKind.ENDPOINTS, 7, [answer, *others])
    assert asking.answers == [answer]
    assert asking.answered == {7}
    assert {probe.publisher_id for probe in probes} == {7}


async def test_actions_are_asked_for_as_metadata_and_as_connections() -> None:
    action = ANNOUNCEMENTS["actions"]
    asking, probes = await asked(HealthKind.ACTIONS, 7, [action])
    assert asking.answers == [action]
    assert {probe.kind for probe in probes} == {ProbeKind.DATA_SET_META_DATA, ProbeKind.PUBSUB_CONNECTIONS}


@pytest.mark.parametrize("kind", HealthKind)
def test_every_table_takes_all_that_answers_it(kind: HealthKind) -> None:
    answers = [announcement for announcement in ANNOUNCEMENTS.values() if isinstance(announcement, ANSWERS[kind])]
    rows = table(kind, answers)
    assert {len(row) for row in rows} == {len(rows[0])}
    assert all(cell.isprintable() for row in rows for cell in row)


def test_what_a_terminal_might_obey_is_escaped() -> None:
    name = ApplicationDescription("urn:\x1b[31m", None, LocalizedText("a\nb"))
    [_, row] = table(HealthKind.APPLICATIONS, [ApplicationAnnouncement(7, U16, 0, name), STATUS])
    assert row == ["7", "a\\nb", "server", "operational", "", "urn:\\x1b[31m"]


def test_a_retired_action_is_shown_as_such() -> None:
    action = ANNOUNCEMENTS["actions"]
    assert isinstance(action, ActionMetaDataAnnouncement)
    [_, row] = table(HealthKind.ACTIONS, [action._replace(targets=(), methods=())])
    assert row[4] == "retired"


@pytest.mark.parametrize(
    ("drops", "heard", "said"),
    [
        ({"secured": 3}, False, "3 dropped as secured: give the fleet's file with -c"),
        ({}, True, "others are heard"),
        ({}, False, "is it running, with this url and interface?"),
    ],
)
def test_why_nobody_may_have_answered(drops: dict[str, int], heard: bool, said: str) -> None:
    assert said in nothing_heard(HealthKind.WRITERS, 7, 3.0, drops, heard)
    assert nothing_heard(HealthKind.WRITERS, None, 3.0, drops, heard).startswith(
        "nobody answered with writers within 3 s; "
    )
