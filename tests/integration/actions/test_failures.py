"""Either side is killed at the worst moment, and half of what is sent is lost: nothing is done twice."""

from __future__ import annotations

import asyncio
import secrets
import signal
from pathlib import Path

import pytest

from tests.contract.skilled import DEADLY_BEGUN_WORK, DEADLY_WORK, ENDLESS_WORK
from tests.integration.actions.conftest import QUICK_ACTION, Cell, work
from tests.integration.actions.requesting import LossyTransport, Requesting
from tests.system import Child, Processes
from tests.waiting import until
from ua_fleet.skill.executions import ExecutionState, OutcomeKind, RequestOutcome

ASKING = Path(__file__).parent / "asking.py"


async def ask_deadly(cell: Cell, requestor: Requesting, what: str, *, forgetful: bool = False) -> RequestOutcome:
    """Ask for what kills the bridge, and start it again."""
    bridge = cell.bridge()
    asking = asyncio.ensure_future(work(requestor, what, 0.1))
    await until(lambda: bridge.process.poll() is not None)
    assert bridge.process.returncode == -signal.SIGKILL
    if forgetful:
        cell.machine.forget()
    cell.bridge()
    return await asking


async def test_bridge_killed_between_its_intent_and_the_machine(cell: Cell) -> None:
    async with cell.requestor() as requestor:
        outcome = await ask_deadly(cell, requestor, DEADLY_WORK)
        assert outcome.kind is OutcomeKind.UNKNOWN
        assert outcome.report.message == "the machine remembers nothing of it"
        assert (await work(requestor, "weld", 0.0)).kind is OutcomeKind.ACCEPTED
    assert cell.told() == ["weld"], "what may have been done is not done again"


async def test_bridge_killed_after_the_machine_was_told(cell: Cell) -> None:
    async with cell.requestor() as requestor:
        outcome = await ask_deadly(cell, requestor, DEADLY_BEGUN_WORK)
        assert outcome.kind is OutcomeKind.ACCEPTED, "the machine says what became of it"
    assert cell.told() == [DEADLY_BEGUN_WORK]


async def test_bridge_killed_after_a_forgetful_machine_was_told(cell: Cell) -> None:
    async with cell.requestor() as requestor:
        outcome = await ask_deadly(cell, requestor, DEADLY_BEGUN_WORK, forgetful=True)
        assert (outcome.kind, outcome.report.state) == (OutcomeKind.UNKNOWN, ExecutionState.UNKNOWN)
    assert cell.told() == [DEADLY_BEGUN_WORK]


async def test_bridge_killed_while_the_machine_works(cell: Cell) -> None:
    bridge = cell.bridge()
    async with cell.requestor() as requestor:
        asking = asyncio.ensure_future(work(requestor, "weld", 2.0, action=QUICK_ACTION))
        await until(cell.told)
        bridge.end(signal.SIGKILL)
        cell.bridge()
        outcome = await asking
    assert (outcome.kind, outcome.report.state) == (OutcomeKind.ACCEPTED, ExecutionState.DONE)
    assert cell.told() == ["weld"]


def asking_process(cell: Cell, processes: Processes, execution_id: bytes, what: str, seconds: float) -> Child:
    folder = cell.folder
    return processes.fork(ASKING, folder / "fleet.json", folder / "requestor0", execution_id.hex(), what, str(seconds))


async def test_requestor_killed_while_it_waits_goes_on(cell: Cell, processes: Processes) -> None:
    cell.bridge()
    (cell.folder / "requestor0").mkdir()
    execution_id = secrets.token_bytes(16)
    asking = asking_process(cell, processes, execution_id, "weld", 1.5)
    await until(cell.told)
    asking.end(signal.SIGKILL)
    async with cell.requestor() as requestor:
        outcome = await requestor.outcome(execution_id)
    assert (outcome.kind, outcome.report.state) == (OutcomeKind.ACCEPTED, ExecutionState.DONE)
    async with cell.requestor() as requestor:
        assert await requestor.outcome(execution_id) == outcome, "it is in the journal"
        assert (await work(requestor, "weld", 1.5, action=QUICK_ACTION, execution_id=execution_id)) == outcome
    assert cell.told() == ["weld"]


@pytest.mark.parametrize("loss", [0.2, 0.5])
async def test_of_what_is_lost_and_repeated_nothing_is_done_twice(cell: Cell, loss: float) -> None:
    cell.bridge()
    transport = LossyTransport(cell.config.pubsub.url, 0.0, seed=7)
    names = [f"job {number}" for number in range(12)]
    async with cell.requestor(transport=transport) as requestor:
        await work(requestor, "first", 0.0)  # the skill is announced before anything is lost
        transport.loss = loss
        outcomes = {name: await work(requestor, name, 0.0) for name in names}
    assert transport.lost > 10
    told = cell.told()
    assert len(set(told)) == len(told), "twice"
    accepted = [name for name in names if outcomes[name].kind is OutcomeKind.ACCEPTED]
    unknown = [name for name in names if outcomes[name].kind is OutcomeKind.UNKNOWN]
    assert len(accepted) >= 10
    assert {outcome.kind for outcome in outcomes.values()} <= {*OutcomeKind} - {OutcomeKind.REFUSED}
    # Where every answer was lost, the requestor says that it does not know: such a job may be done or not.
    assert [name for name in names if name in told and name not in unknown] == accepted
    assert not unknown or loss > 0.2


async def test_a_bridge_that_is_gone_leaves_the_outcome_unknown(cell: Cell) -> None:
    bridge = cell.bridge()
    async with cell.requestor() as requestor:
        assert (await work(requestor, ENDLESS_WORK, 0.0)).kind is OutcomeKind.ACCEPTED
        bridge.end(signal.SIGKILL)
        outcome = await work(requestor, "weld", 0.0, timeout_s=0.5)
        assert outcome.kind is OutcomeKind.UNKNOWN
        assert outcome.report.message == "no answer came; see what the robot does"
    assert cell.told() == [ENDLESS_WORK]
