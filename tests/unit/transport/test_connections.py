"""Where what a process sends goes, of several connections, and what it calls those that it hears."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.unit.pubsub.publishing import Writing
from tests.unit.pubsub.security.securing import NONE, SIGN, action, data, envelope, group_keys, probe
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.transport.base import Address, Receive, TransportStats
from ua_fleet.transport.connections import Connection, Connections, Sender
from ua_fleet.transport.sealed import SealedSender
from ua_fleet.wire import read_security


class Line:
    """A transport that notes what it is to send."""

    def __init__(self) -> None:
        self.stats = TransportStats()
        self.sent: list[tuple[bytes, Address | None]] = []
        self.receive: Receive | None = None
        self.own: Address = ("10.0.0.1", 7)
        self.is_closed = False

    def is_own(self, sender: Address) -> bool:
        return sender == self.own

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        self.sent.append((datagram, address))

    async def start(self, receive: Receive) -> None:
        self.receive = receive

    async def close(self) -> None:
        self.is_closed = True


class Three:
    """A server on `hall`, `site` and `open`, the last of which takes no Actions."""

    def __init__(self, count: int = 3) -> None:
        self.lines = [Line() for _ in range(count)]
        self.counters = Counters()
        names = ("hall", "site", "open")
        self.connections = Connections(
            [
                Connection(name, line, plain_envelope(), takes_actions=name != "open")
                for name, line in zip(names, self.lines, strict=False)
            ],
            routes={1: (0,), 2: (1,), 3: (0, 1), 4: ()},
            setpoint_groups={60: 2},
        )
        senders = [SealedSender(each.envelope, each.transport, lambda: 0.0) for each in self.connections.all]
        self.send: Callable[..., None] = Sender(self.connections, senders, self.counters).send

    def went(self, datagram: bytes, address: Address | None = None) -> list[int]:
        """The connections by which a message goes."""
        before = [len(line.sent) for line in self.lines]
        self.send(datagram, address)
        return [number for number, line in enumerate(self.lines) if len(line.sent) > before[number]]


def plain_envelope() -> Envelope:
    return Envelope(0, Counters(), mode=NONE, nonces=MemoryNonces())


def test_data_announcements_and_probes_go_by_all() -> None:
    three = Three()
    writing = Writing()
    for message in (data(), probe(), *writing.announce(), *writing.publish(1.0)):
        assert three.went(message) == [0, 1, 2]


@pytest.mark.parametrize(("space", "ways"), [(1, [0]), (2, [1]), (3, [0, 1]), (9, [0, 1])])
def test_an_action_goes_where_its_bridge_is_and_of_an_unknown_one_wherever_actions_go(
    space: int, ways: list[int]
) -> None:
    assert Three().went(action(publisher_id=space)) == ways


def test_an_action_that_has_no_way_is_counted() -> None:
    three = Three()
    assert three.went(action(publisher_id=4)) == []
    assert three.counters.drops == {Drop.NOT_ITS_CONNECTION: 1}


def test_setpoints_go_where_their_bridge_is_and_other_data_of_the_server_by_all() -> None:
    three = Three()
    assert three.went(data(publisher_id=0, writer_group_id=60)) == [1]
    assert three.went(data(publisher_id=0, writer_group_id=2)) == [0, 1, 2]


async def test_senders_have_the_name_of_their_connection_and_answers_go_back_by_it() -> None:
    three = Three()
    heard: list[tuple[Any, ...]] = []

    def hear(datagram: bytes, sender: Address, *, is_fresh: bool = True, connection: int = 0) -> None:
        heard.append((datagram, sender, is_fresh, connection))

    await three.connections.start(hear)
    for line in three.lines[:2]:
        assert line.receive is not None
        line.receive(b"x", ("10.0.0.7", 4840))
    assert heard == [
        (b"x", ("hall|10.0.0.7", 4840), True, 0),
        (b"x", ("site|10.0.0.7", 4840), True, 1),
    ]
    to = three.connections.answer_address(None, heard[1][1])
    assert to == ("site|10.0.0.7", 4840)
    assert three.went(action(publisher_id=1), to) == [1]
    assert three.lines[1].sent[-1][1] == ("10.0.0.7", 4840)
    await three.connections.close()
    assert all(line.is_closed for line in three.lines)


async def test_with_one_connection_nothing_is_added() -> None:
    one = Three(1)
    heard: list[Address] = []

    def hear(datagram: bytes, sender: Address, *, is_fresh: bool = True, connection: int = 0) -> None:
        assert (datagram, is_fresh, connection) == (b"x", True, 0)
        heard.append(sender)

    await one.connections.start(hear)
    assert one.lines[0].receive is not None
    one.lines[0].receive(b"x", ("10.0.0.7", 4840))
    assert heard == [("10.0.0.7", 4840)]
    assert one.connections.answer_address(None, heard[0]) == heard[0]
    assert one.went(action(publisher_id=4)) == [0]
    assert one.connections.stats is one.lines[0].stats


def test_each_knows_its_own_messages_by_the_connection_that_they_came_by() -> None:
    three = Three()
    three.lines[1].own = ("10.0.0.2", 8)
    assert three.connections.know_themselves
    assert three.connections.is_own(("hall|10.0.0.1", 7))
    assert not three.connections.is_own(("site|10.0.0.1", 7))
    assert three.connections.is_own(("site|10.0.0.2", 8))


def test_figures_are_those_of_all_and_there_is_a_problem_where_none_works() -> None:
    three = Three()
    for number, line in enumerate(three.lines):
        line.stats.sent, line.stats.kernel_drops = 10, number
    three.lines[1].stats.problem = "site: the broker is away"
    three.lines[1].stats.drops[Drop.BROKER_AWAY] = 3
    three.lines[1].stats.malformed["json_syntax"] = 2
    three.lines[2].stats.forgiven["number_as_text"] = 4
    whole = three.connections.stats
    assert (whole.sent, whole.kernel_drops, whole.problem) == (30, 3, "")
    assert three.connections.problem == "site: the broker is away"
    counters = Counters()
    three.connections.count_drops(counters)
    three.connections.count_drops(counters)
    drops = {cause: count for cause, count in counters.drops.items() if count}
    assert drops == {Drop.KERNEL: 3, Drop.BROKER_AWAY: 3, Drop.MALFORMED: 2}
    assert (counters.malformed, counters.forgiven) == ({"json_syntax": 2}, {"number_as_text": 4})
    for line in three.lines:
        line.stats.problem = "away"
    assert three.connections.stats.problem == "away; away; away"


def test_keys_are_those_of_all_envelopes_and_no_nonce_is_used_twice() -> None:
    nonces, group = MemoryNonces(), telemetry_group(1)
    sealing = [envelope(1, mode=SIGN, nonces=nonces, random=5) for _ in range(2)]
    keys = Connections(
        [Connection(name, Line(), each) for name, each in zip("ab", [*sealing], strict=True)]
        + [Connection("c", Line(), plain_envelope())]
    ).envelopes
    assert keys.is_secured
    assert not keys.are_encrypted
    assert keys.groups_wanted() == [group]
    assert keys.keys_wanted(0.0) == [group]
    keys.install(group, group_keys(), 0.0)
    assert keys.keys_wanted(0.0) == []
    assert list(keys.keys_last_s(1.0)) == [group]
    used = [read_security(part).nonce for each in sealing for _ in range(3) for part in each.seal(data(), 0.0)]
    assert len(used) == len(set(used)) == 6
    assert len({nonce[:4] for nonce in used}) == 1, "each knows the other's for its own"
    assert command_group(1) not in keys.groups_wanted()
