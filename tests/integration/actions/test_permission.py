"""Requests that must not be done: unsigned, of a stranger's keys, of a space that may not command, replayed."""

from __future__ import annotations

import secrets
import time
from typing import Any

from tests.contract.skilled import TARGET
from tests.integration.actions.conftest import ACTION, SPACE, Cell, work
from tests.integration.actions.requesting import Requesting
from tests.waiting import until
from ua_fleet.bridge import STATUS_FIELDS
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.skill.executions import OutcomeKind
from ua_fleet.topics import Topic
from ua_fleet.transport.base import Address
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire.actions import ActionMessage, ActionState, encode_action
from ua_fleet.wire.security import SecurityMode, SecurityPolicy

STATUS = Topic(SPACE, 2, 900)
POLICY = SecurityPolicy.AES256_CTR


def request(requestor_id: str = "0.server", **changes: Any) -> bytes:
    """A request that would be done if it were let in."""
    message = ActionMessage(
        SPACE,
        ACTION.ns,
        ACTION.id,
        TARGET,
        1,
        ActionState.EXECUTING,
        is_request=True,
        requestor_id=requestor_id,
        correlation_data=secrets.token_bytes(16),
        timeout_hint_ms=5000.0,
        types=(BuiltinType.STRING, BuiltinType.DOUBLE),
        values=("forged", 0.0),
        timestamp=ticks_from_unix_ns(time.time_ns()),
    )
    return encode_action(message._replace(**changes))


def counted(requestor: Requesting, drop: Drop) -> int:
    """What the bridge says it has dropped."""
    message = requestor.status.get(STATUS)
    names = [field.name for field in STATUS_FIELDS]
    return 0 if message is None else int(message.values[names.index(f"Drops.{drop.value}")])


async def let_in_nothing(cell: Cell, requestor: Requesting, drop: Drop, count: int = 1) -> None:
    """The bridge counts it, does nothing of it, and works on."""
    await until(lambda: counted(requestor, drop) >= count)
    assert cell.told() == []
    assert (await work(requestor, "weld", 0.0)).kind is OutcomeKind.ACCEPTED
    assert cell.told() == ["weld"]


async def test_an_unsigned_request_is_never_done(secured_cell: Cell) -> None:
    secured_cell.bridge()
    async with secured_cell.requestor() as requestor:
        for _ in range(3):
            requestor.transport.send(request())
        await let_in_nothing(secured_cell, requestor, Drop.NOT_SECURED, 3)


async def test_a_request_signed_with_other_keys_is_never_done(secured_cell: Cell) -> None:
    envelope = Envelope(0, Counters(), mode=SecurityMode.SIGN_AND_ENCRYPT, nonces=MemoryNonces())
    keys = GroupKeys(POLICY, 1, (secrets.token_bytes(POLICY.key_data_bytes),), 3600.0, 3600.0)
    envelope.install(f"c-{SPACE}", keys, 0.0)
    secured_cell.bridge()
    async with secured_cell.requestor() as requestor:
        for sealed in envelope.seal(request(), 0.0):
            requestor.transport.send(sealed)
        await let_in_nothing(secured_cell, requestor, Drop.BAD_SIGNATURE)


async def test_a_replayed_request_is_dropped(secured_cell: Cell) -> None:
    secured_cell.bridge()
    async with secured_cell.requestor() as requestor:
        [sealed] = requestor.envelope.seal(request(), 0.0)
        for _ in range(3):
            requestor.transport.send(sealed)
        await until(lambda: counted(requestor, Drop.REPLAYED) == 2)
    assert secured_cell.told() == ["forged"]


async def test_a_space_that_may_not_command_is_refused(cell: Cell) -> None:
    """Who has the keys and claims another space is refused by what it claims."""
    cell.bridge()
    async with cell.requestor() as requestor:
        requestor.send(request(f"{SPACE + 1}.bridge"))
        await let_in_nothing(cell, requestor, Drop.REQUESTOR)


async def test_a_requestor_without_a_name_is_dropped(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        for name in ("", "server", "0", "0.", "-1.x", "70000.x", "00.server"):
            requestor.send(request(name))
        await let_in_nothing(cell, requestor, Drop.REQUESTOR, 7)


async def test_a_bridge_does_not_command_itself(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        await until(lambda: STATUS in requestor.status)
        before = counted(requestor, Drop.LOOP)
        requestor.send(request(f"{SPACE}.cell"))
        await let_in_nothing(cell, requestor, Drop.LOOP, before + 1)


async def test_the_answer_goes_to_the_response_address(cell: Cell) -> None:
    cell.bridge()
    heard: list[tuple[bytes, Address]] = []
    async with cell.requestor() as requestor, cell.requestor(space=SPACE + 1) as beside:
        receive = beside.receive

        def listen(datagram: bytes, sender: Address) -> None:
            heard.append((datagram, sender))
            receive(datagram, sender)

        beside.receive = listen  # type: ignore[method-assign]  # to see where it comes from
        requestor.transport.send(b"who am I")
        await until(lambda: any(datagram == b"who am I" for datagram, _ in heard))
        host, port = next(sender for datagram, sender in heard if datagram == b"who am I")
        before = requestor.transport.stats.received
        requestor.send(request(response_address=f"opc.udp://{host}:{port}"))
        await until(cell.told)
        await until(lambda: requestor.transport.stats.received > before)
        requestor.send(request(response_address="opc.udp://robot.local:4840"))
        await until(lambda: counted(requestor, Drop.MALFORMED) >= 2)
    assert cell.told() == ["forged"], "nobody would hear what became of the other one"


async def test_an_unknown_skill_is_refused_with_its_reason(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        assert (await work(requestor, "weld", 0.0)).kind is OutcomeKind.ACCEPTED
        commands = requestor.commands
        known = commands.action(ACTION)
        assert known is not None
        commands.announced(known._replace(data_set_writer_id=4711))
        outcome = await requestor.invoke(Topic(SPACE, 2, 4711), ("weld", 0.0), 5.0)
    assert outcome.kind is OutcomeKind.REFUSED
    assert (outcome.report.status, outcome.report.message) == (
        StatusCode.BAD_NOT_SUPPORTED,
        "there is no such skill here",
    )
