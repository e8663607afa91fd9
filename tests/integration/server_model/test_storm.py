"""1,000 robots that fall silent at once, through a whole server: what others notice of it."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pytest

from tests.integration.peer import Peer
from tests.integration.server_model.harness import SPACE, fleet_config, serving, ua, until
from tests.integration.server_model.test_summaries import robots
from tests.waiting import until as until_holds
from ua_fleet.nodes.scenario_nodes import SPARED_FAULTS, ScenarioNodes
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

ROBOTS: Final = 1_000
FIELD: Final = (make_field("data", BuiltinType.DOUBLE),)
READ_EACH_S: Final = 0.1
MOST_TRANSACTIONS: Final = ROBOTS // 20
"""Four on a quiet machine: a busy one looks for silent robots more often before it has found all."""
LEAST_TURNS: Final = 5
"""Of the event loop while faults are shown: 59 on a machine that takes 2.2 s for it."""
LEAST_READS: Final = 2
NODES_OF_FAULT: Final = 34


@dataclass
class Noted:
    """What the server has done, and what others could do meanwhile."""

    transactions: int = 0
    shown: list[float] = field(default_factory=list[float])
    """When each fault came into the nodes."""
    turns: list[float] = field(default_factory=list[float])
    """Of the event loop."""
    reads: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    """When each was sent and answered."""


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> Noted:
    noted = Noted()
    write, show_fault = RunJournal.write, ScenarioNodes.show_fault

    def counted(self: RunJournal, *args: Any) -> None:
        noted.transactions += 1
        write(self, *args)

    def shown(self: ScenarioNodes, *args: Any) -> None:
        noted.shown.append(time.monotonic())
        show_fault(self, *args)

    monkeypatch.setattr(RunJournal, "write", counted)
    monkeypatch.setattr(ScenarioNodes, "show_fault", shown)
    return noted


@asynccontextmanager
async def looking(client: Any, noted: Noted) -> AsyncGenerator[None]:
    """A client reads each 100 ms; and each turn of the event loop is noted."""

    async def look() -> None:
        node = client.get_node(ua.NodeId(1, 2))
        while True:
            sent = time.monotonic()
            await node.read_data_value(raise_on_bad_status=False)
            noted.reads.append((sent, time.monotonic()))
            await asyncio.sleep(READ_EACH_S)

    async def take_turns() -> None:
        while True:
            noted.turns.append(time.monotonic())
            await asyncio.sleep(0.001)

    tasks = [asyncio.ensure_future(look()), asyncio.ensure_future(take_turns())]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)


async def all_well(peer: Peer, client: Any) -> None:
    """All robots have said something, and are there."""
    topics = [Topic(SPACE, 2, 1 + number) for number in range(ROBOTS)]
    nodes = [client.get_node(f"ns=2;s=Robots.r{number}.State") for number in range(ROBOTS)]
    for topic in topics:
        peer.announce(topic, FIELD)

    async def states() -> set[int]:
        for topic in topics:
            peer.publish(topic, 0.5)
        return set(await client.read_values(nodes))

    assert await until(states, lambda found: found == {1}, 60)


async def test_a_storm_of_faults_keeps_nobody_out(udp_url: str, tcp_port: int, tmp_path: Path, noted: Noted) -> None:
    """Each fault was a transaction with all that still waited, and nobody else had a turn meanwhile."""
    config = fleet_config(udp_url, tcp_port, robots=robots(ROBOTS))
    config = config.model_copy(
        update={"pubsub": config.pubsub.model_copy(update={"keep_alive_s": 1.0, "receive_timeout_s": 6.0})}
    )
    async with serving(tmp_path, config, start_s=120) as running, running.client() as client:
        told: list[str] = []

        class Handler:
            def event_notification(self, event: Any) -> None:
                told.append(event.Message.Text)

        subscription: Any = await client.create_subscription(500, Handler())
        await subscription.subscribe_events(client.nodes.server, ua.NodeId(ua.ObjectIds.AlarmConditionType))
        await all_well(running.peer, client)
        noted.shown.clear()
        noted.transactions = 0
        told.clear()
        async with looking(client, noted):
            running.peer.mute()
            frozen = gc.get_freeze_count()
            await until_holds(lambda: len(noted.shown) >= ROBOTS, "the faults of all robots", 120)
            began, ended = noted.shown[0], noted.shown[-1]
            assert gc.get_freeze_count() - frozen >= (ROBOTS - SPARED_FAULTS) * NODES_OF_FAULT
            async with running.client() as late:  # nobody is kept out
                assert await late.nodes.server.get_children()
        await until_holds(lambda: len(told) >= ROBOTS, "the events of all faults", 60)
    turns = sum(began < turn < ended for turn in noted.turns)
    reads = sum(began < sent and done < ended for sent, done in noted.reads)
    assert noted.transactions <= MOST_TRANSACTIONS
    assert turns >= LEAST_TURNS
    assert reads >= LEAST_READS
