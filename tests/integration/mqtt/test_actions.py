"""Skills of a real bridge, asked for over a real broker: once, never late, and never because a broker kept them."""

from __future__ import annotations

import asyncio
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.contract.skilled import STATUS
from tests.integration.actions.conftest import QUICK_ACTION, SPACE, Cell, work
from tests.integration.mqtt.broker import Broker, nats
from tests.integration.mqtt.conftest import Subscribe
from tests.system import Processes
from tests.waiting import until
from ua_fleet.skill.executions import ExecutionState, OutcomeKind, unpack
from ua_fleet.topics import Topic

pytestmark = pytest.mark.needs("mosquitto")

JSON: dict[str, Any] = {"encoding": "json", "actions": True}


@pytest.fixture(params=["none", "sign_and_encrypt", "broker"])
def cell(request: pytest.FixtureRequest, tmp_path: Path, broker: Broker, processes: Processes) -> Cell:
    """With and without message security, and as JSON, over mosquitto."""
    return Cell(tmp_path, broker.url, processes, request.param, **JSON if request.param == "broker" else {})


def requests_topic(cell: Cell) -> str:
    """Where the bridge of a cell is asked."""
    return f"opcua/{cell.config.pubsub.encoding.value}/action-request/{SPACE}/actions-2"


async def test_a_skill_is_accepted_and_done_once_and_its_result_comes_back(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        outcomes = [await work(requestor, f"weld {number}", 0.0) for number in range(5)]
        quick = await work(requestor, "measure", 0.2, action=QUICK_ACTION)
        await until(lambda: Topic(SPACE, 2, STATUS) in requestor.status)
    assert [outcome.kind for outcome in outcomes] == [OutcomeKind.ACCEPTED] * 5
    assert (quick.kind, quick.report.state) == (OutcomeKind.ACCEPTED, ExecutionState.DONE)
    assert [result.value for result in unpack(quick.report.result)] == ["measure", 0.2]
    assert cell.told() == [*[f"weld {number}" for number in range(5)], "measure"]


@pytest.mark.needs("nats")
async def test_a_skill_over_mqtt_3_1_1(tmp_path: Path, processes: Processes) -> None:
    broker = nats(tmp_path / "nats")
    broker.start()
    try:
        cell = Cell(tmp_path, broker.url, processes, "sign_and_encrypt")
        cell.bridge()
        async with cell.requestor() as requestor:
            assert (await work(requestor, "weld", 0.0)).kind is OutcomeKind.ACCEPTED
        assert cell.told() == ["weld"]
    finally:
        broker.end()


async def test_what_waited_at_a_broker_that_stood_still_is_not_done(cell: Cell, broker: Broker) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        assert (await work(requestor, "weld", 0.0)).kind is OutcomeKind.ACCEPTED
        broker.freeze()
        asking = asyncio.ensure_future(work(requestor, "late", 0.0, timeout_s=0.5))
        await asyncio.sleep(1.0)  # the time that is not to be late by
        broker.go_on()
        outcome = await asking
        assert outcome.kind in (OutcomeKind.TIMED_OUT, OutcomeKind.UNKNOWN)
        assert (await work(requestor, "after", 0.0)).kind is OutcomeKind.ACCEPTED
    assert cell.told() == ["weld", "after"]


async def test_what_was_asked_while_the_broker_was_away_is_not_done_when_it_is_back(cell: Cell, broker: Broker) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        assert (await work(requestor, "weld", 0.0)).kind is OutcomeKind.ACCEPTED
        broker.end(9)
        outcome = await work(requestor, "late", 0.0, timeout_s=0.3)
        assert outcome.kind is OutcomeKind.UNKNOWN
        broker.start()
        await until(lambda: not requestor.transport.stats.problem)
        assert (await work(requestor, "after", 0.0)).kind is OutcomeKind.ACCEPTED
    assert cell.told() == ["weld", "after"]


async def test_a_request_that_somebody_had_the_broker_retain_is_dropped_and_counted(
    cell: Cell, broker: Broker, subscribe: Subscribe, tmp_path: Path
) -> None:
    topic = requests_topic(cell)
    hearing = subscribe(broker, topic)
    first = cell.bridge()
    async with cell.requestor() as requestor:
        await until(lambda: requestor.transport.stats.received)
        assert (await work(requestor, "weld", 0.0)).kind is OutcomeKind.ACCEPTED
        line = hearing.wait_for(topic)
        first.end()
        cell.machine.forget()
        recorded = tmp_path / "recorded"
        recorded.write_bytes(bytes.fromhex(line.split()[2]))
        publish = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(broker.port), "-r", "-q", "1", "-t", topic]
        subprocess.run([*publish, "-f", str(recorded)], check=True)
        again = cell.bridge()
        assert (await work(requestor, "after", 0.0)).kind is OutcomeKind.ACCEPTED
        await until(lambda: requestor.status)
    assert "after" in cell.told()
    assert cell.told().count("weld") <= 1
    assert again.end() == 0
