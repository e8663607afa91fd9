"""Between the registers and the OPC UA server: values in, writes and commands out, decisions both ways.

While the server is away PLCs read what was last, with `connected` 0 and every value marked as not Good. A command that
comes meanwhile is refused, and one that runs is followed again afterwards.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager, aclosing
from typing import Any, Final

import structlog

from ua_fleet.client import DecisionInfo, FaultInfo, FleetClient, NodeNotFound, NotDone, ScenarioClient
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import AccessRefused, NotConnected, SendTimeout, SkillError, UaFleetError
from ua_fleet.modbus.commands import CommandDesk, PendingCommand
from ua_fleet.modbus.decisions import DecisionDesk, PlcAnswer
from ua_fleet.modbus.following import Followed, Patience, follow_run, follow_skill
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.memory import CommandMemory
from ua_fleet.modbus.table import MappedValue, map_rows, modbus_commands, modbus_values
from ua_fleet.modbus.words import CommandState, DecisionOutcome, status
from ua_fleet.monitoring import Mistakes
from ua_fleet.registers import AddressSpan, RegisterUnfit, cast
from ua_fleet.values import Quality, StatusCode, quality_of

__all__ = ["Gateway"]

HEARTBEAT_S: Final = 0.5
POLL_S: Final = 0.2
"""How often executions, decisions and faults are looked at."""
RETRY_S: Final = (0.5, 10.0)
_AWAY: Final = (NotConnected, SendTimeout, AccessRefused)

Connect = Callable[[], AbstractAsyncContextManager[FleetClient]]


class Gateway:
    """One fleet as a Modbus device. `written` is called by the listener, all else runs in `run`."""

    def __init__(self, config: FleetConfig, memory: CommandMemory) -> None:
        """Make the tables, with what is remembered."""
        assert config.modbus is not None
        self.mistakes = Mistakes()
        """What has cost a value or a command."""
        self._is_started = False
        self._config, self._modbus = config, config.modbus
        self._values = modbus_values(config)
        rows = map_rows(config)
        self.image = Image(
            [row.register for row in rows if not row.is_written], [row.register for row in rows if row.is_written]
        )
        self._desk = CommandDesk(self.image, memory, modbus_commands(config), self._modbus.control, self._modbus.status)
        self._decisions = DecisionDesk(self.image, memory, self._modbus)
        self._sets = {value.path: value for value in self._values if value.is_written}
        self._to_set: dict[str, MappedValue] = {}
        self._work = asyncio.Event()
        self._patience = Patience()
        self._told: set[str] = set()
        self.problem = "no connection to the OPC UA server yet"
        """Why the OPC UA server is not there; empty while it is."""
        self._has_told_away = False
        self._log: Any = structlog.get_logger(part="modbus")

    def written(self, span: AddressSpan) -> None:
        """A PLC has written something."""
        with self.mistakes.guard("writes of PLCs"):
            self._desk.written(span)
        with self.mistakes.guard("writes of PLCs"):
            self._decisions.written(span)
        for value in self._sets.values():
            if value.register.span.overlaps(span):
                self._to_set[value.path] = value
        self._work.set()

    async def run(self, connect: Connect) -> None:
        """Work until cancelled; `connect` makes a connected client."""
        keep = self.mistakes.keep
        works = (
            keep("heartbeat", self._beat),
            keep("refusals", self._refuse_while_away),
            self._stay_connected(connect),
        )
        running = {asyncio.create_task(work) for work in works}
        try:
            ended, _ = await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
            for task in ended:
                task.result()  # none ends but by an error
        finally:
            while running:  # Python 3.11's wait_for, which asyncua uses, loses some cancellations
                for task in running:
                    task.cancel()
                _, running = await asyncio.wait(running, timeout=0.2)

    # Away

    async def _stay_connected(self, connect: Connect) -> None:
        wait_s = RETRY_S[0]
        while True:
            try:
                async with connect() as client:
                    wait_s = RETRY_S[0]
                    self.problem, self._is_started = "", True
                    self._log.info("the OPC UA server is reachable", endpoint=client.endpoint)
                    await self._serve(client)
            except ExceptionGroup as failed:
                for error in failed.exceptions:
                    self._lost(error)
            except Exception as error:  # noqa: BLE001 - raised again where it is a failed start
                self._lost(error)
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, RETRY_S[1])

    def _lost(self, error: Exception) -> None:
        """A connection has ended; what has ended the first one, and is not that nobody answers, ends the gateway."""
        if not isinstance(error, _AWAY):
            if not self._is_started:
                raise error
            self.mistakes.caught("connection", error)
        self._go_away(str(error))

    def _go_away(self, reason: str) -> None:
        if not self.problem or not self._has_told_away:
            self._log.warning("the OPC UA server is not reachable", reason=reason)
            self._has_told_away = True
        self.problem = f"the OPC UA server is not reachable: {reason}"
        self.image.put(self._status("connected"), 0)
        for value in self._values:
            if value.quality is not None:
                self.image.put(value.quality, False)
        self._refuse()

    async def _beat(self) -> None:
        count = 0
        while True:
            count = (count + 1) & 0xFFFF
            self.image.put(self._status("heartbeat"), count)
            self._desk.record_again()
            await asyncio.sleep(HEARTBEAT_S)

    async def _refuse_while_away(self) -> None:
        """What is asked for while nobody can be asked is not done later, when nobody expects it."""
        while True:
            await self._work.wait()
            if not self.image.get(self._status("connected")):
                self._refuse()
                self._work.clear()
            await asyncio.sleep(POLL_S)

    def _refuse(self) -> None:
        while self._desk.take() is not None:  # another one may have waited for the end of the first
            self._desk.end(CommandState.REFUSED, StatusCode.BAD_NOT_CONNECTED, "the OPC UA server is not reachable")
        self._decisions.refuse()
        self._to_set.clear()

    # There

    async def _serve(self, client: FleetClient) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._read(client))
            tasks.create_task(self._command(client))
            tasks.create_task(self._decide(ScenarioClient(client)))
            self.image.put(self._status("connected"), 1)

    async def _read(self, client: FleetClient) -> None:
        by_node: dict[str, list[MappedValue]] = {}
        for value in self._values:
            by_node.setdefault(value.node_id, []).append(value)
        known = await self._known(client, by_node, list(by_node))
        if not known:
            return
        async with aclosing(client.watch(known)) as changes:
            async for change in changes:
                for value in by_node[change.node_id]:
                    if not (value.is_written and value.path in self._to_set):
                        with self.mistakes.guard("values", what=value.path):
                            self._show(value, change.value, change.status)

    async def _known(
        self, client: FleetClient, by_node: Mapping[str, list[MappedValue]], nodes: list[str]
    ) -> list[str]:
        """Those of the nodes that the server has: its fleet.yaml may be another one. The others are told of."""
        try:
            if nodes:
                await client.read(nodes)
        except NodeNotFound as error:
            if len(nodes) == 1:
                self._tell(f"{by_node[nodes[0]][0].path} cannot be shown: {error}")
                return []
            half = len(nodes) // 2
            return [node for part in (nodes[:half], nodes[half:]) for node in await self._known(client, by_node, part)]
        return nodes

    def _show(self, value: MappedValue, shown: Any, code: int) -> None:
        is_good = False
        if quality_of(code) is Quality.GOOD and shown is not None:
            try:
                self.image.put(value.register, shown)
                is_good = True
            except RegisterUnfit as unfit:
                self._tell(f"{value.path} cannot be shown: {unfit.reason}")
        if value.quality is not None:
            self.image.put(value.quality, is_good)

    async def _command(self, client: FleetClient) -> None:
        scenarios = ScenarioClient(client)
        self._patience = Patience()  # nobody was listened to meanwhile
        while True:
            is_asked = self._desk.last.state is CommandState.ASKING
            await self._set_all(client)  # what was written before the command is set before it is begun
            if is_asked and (asked := self._desk.take()) is not None:
                self._patience = Patience()
                await self._begin(client, scenarios, asked)
            if self._desk.last.state is CommandState.RUNNING:
                await self._follow(client, scenarios)
                await asyncio.sleep(POLL_S)
                continue
            try:
                async with asyncio.timeout(1.0):
                    await self._work.wait()
            except TimeoutError:
                pass
            self._work.clear()

    async def _begin(self, client: FleetClient, scenarios: ScenarioClient, asked: PendingCommand) -> None:
        config = asked.command.config
        try:
            if config.scenario is not None:
                given = {name: _text(value) for name, value in asked.arguments.items()}
                self._desk.began(await scenarios.run(config.scenario, given))
            else:
                assert config.robot is not None
                assert config.skill is not None
                execution = await client.start_skill(config.robot, config.skill, **asked.arguments)
                self._desk.began(execution.id)
        except (NotConnected, SendTimeout, asyncio.CancelledError):  # cancelled: another task saw first that it is away
            text = "the answer was lost; see whether it was begun"
            self._desk.end(CommandState.UNKNOWN, StatusCode.UNCERTAIN, text)
            raise
        except (SkillError, NotDone, NodeNotFound, AccessRefused) as error:
            self._desk.end(CommandState.REFUSED, error.ua_status, _short(error))
        except Exception as error:  # noqa: BLE001 - costs this command, and not the gateway
            self.mistakes.caught("commands", error)
            self._desk.end(CommandState.UNKNOWN, StatusCode.UNCERTAIN, "a mistake of the gateway; see its log")

    async def _follow(self, client: FleetClient, scenarios: ScenarioClient) -> None:
        last = self._desk.last
        command = modbus_commands(self._config).get(last.code)
        if command is None:
            self._desk.end(CommandState.UNKNOWN, StatusCode.UNCERTAIN, "fleet.yaml has no such command any more")
            return
        if command.config.scenario is not None:
            followed = await follow_run(scenarios, last.begun)
        else:
            assert command.config.robot is not None
            assert command.config.skill is not None
            followed = await follow_skill(client, self._config, command.config.robot, command.config.skill, last.begun)
        self._told_of(followed, asyncio.get_running_loop().time())

    def _told_of(self, followed: Followed, now: float) -> None:
        if followed.state is not CommandState.RUNNING:
            self._desk.end(followed.state, followed.status, followed.message, followed.results)
        elif self._patience.is_over(followed, now):
            self._desk.end(CommandState.UNKNOWN, StatusCode.UNCERTAIN, followed.message)
        elif followed.patience_s is None:
            self._desk.progress(followed.progress)

    async def _set_all(self, client: FleetClient) -> None:
        for path, value in list(self._to_set.items()):
            cells = self.image.cells(value.register.span)
            try:
                wanted = cast(self.image.get(value.register), value.type.builtin)
                await client.write(value.node_id, _text(wanted))
            except (RegisterUnfit, AccessRefused, NodeNotFound) as error:
                self._tell(f"{path} cannot be set: {error}")
            except _AWAY:
                raise
            except Exception as error:  # noqa: BLE001 - costs this value, and not those behind it
                self.mistakes.caught("values", error, what=path)
            if self.image.cells(value.register.span) == cells:  # otherwise the PLC has written another one meanwhile
                self._to_set.pop(path, None)

    async def _decide(self, scenarios: ScenarioClient) -> None:
        while True:
            try:
                decisions: list[DecisionInfo] = await scenarios.decisions()
                faults: list[FaultInfo] = await scenarios.faults()
            except NodeNotFound:
                pass  # one of them went while they were read; the next look shows those that are there
            else:
                with self.mistakes.guard("decisions"):
                    self._decisions.show(decisions, faults)
            if (answer := self._decisions.take()) is not None:  # for what is open now, also after a time away
                await self._choose(scenarios, answer)
            await asyncio.sleep(POLL_S)

    async def _choose(self, scenarios: ScenarioClient, answer: PlcAnswer) -> None:
        try:
            await scenarios.confirm(answer.decision_id, answer.robot)
        except (NotDone, AccessRefused, NodeNotFound) as error:
            self._tell(f"{answer.robot} was not chosen: {error}")
            self._decisions.answered(answer, DecisionOutcome.REFUSED)
        except BaseException:  # the answer was lost; cancelled: another task saw first that the server is away
            self._decisions.answered(answer, DecisionOutcome.UNKNOWN)
            raise
        else:
            self._decisions.answered(answer, DecisionOutcome.TAKEN)

    def _tell(self, text: str) -> None:
        """Log a problem once."""
        if text not in self._told and len(self._told) < 256:
            self._told.add(text)
            self._log.warning(text)

    def _status(self, name: str) -> Any:
        return status(name, self._modbus.status)


def _text(value: Any) -> str:
    """A value as text: as YAML, and clients' texts, have it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.0f}" if isinstance(value, float) and value.is_integer() else str(value)


def _short(error: UaFleetError) -> str:
    return " ".join(str(error).split())
