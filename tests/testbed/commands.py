"""Short skills that are asked of robots one after the other while things go wrong, and what became of each."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from tests.testbed.ledger import Command, Outcome
from tests.testbed.watching import Watcher
from ua_fleet.client import FleetClient, SkillExecution
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import (
    AccessRefused,
    NotConnected,
    RobotOffline,
    SendTimeout,
    SkillFailed,
    SkillRejected,
    SkillTimeout,
    UaFleetError,
)
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.values import Quality, quality_of

__all__ = ["Arguments", "Asked", "Commands"]

Arguments = Callable[[int], Mapping[str, Any]]
"""Of the n-th time that a skill is asked for."""
Asked = Mapping[str, Sequence[tuple[str, Arguments]]]
"""What is asked of each robot in turn."""

PAUSE_S: Final = 1.0
"""Between two commands of a robot, so that two a second are asked of all of them."""
PATIENCE_S: Final = 6.0
"""After so long the next one is asked for, and the end of this one is still waited for."""
LOOK_S: Final = 1.0
_ENDS: Final = {
    ExecutionState.REFUSED: Outcome.REFUSED,
    ExecutionState.TIMED_OUT: Outcome.REFUSED,
    ExecutionState.DONE: Outcome.DONE,
    ExecutionState.FAILED: Outcome.FAILED,
    ExecutionState.UNKNOWN: Outcome.UNKNOWN,
}


class Commands:
    """The commands of one run. `run` asks while `begin` has been called and `stop` has not."""

    def __init__(self, watcher: Watcher, config: FleetConfig, asked: Asked) -> None:
        """Prepare to ask all robots of `asked`."""
        self._watcher, self._config, self._asked = watcher, config, asked
        self.all: list[Command] = []
        self._go = asyncio.Event()
        self._busy = 0

    def begin(self) -> None:
        """Ask from now on."""
        self._go.set()

    async def stop(self) -> None:
        """Ask for nothing more; ends when nothing is on its way, or an end does not come."""
        self._go.clear()
        deadline = time.monotonic() + PATIENCE_S + 2
        while (self._busy or self.open()) and time.monotonic() < deadline:
            await asyncio.sleep(0.1)

    def open(self) -> list[Command]:
        """Those whose end has not been told."""
        return [command for command in self.all if command.outcome is Outcome.OPEN]

    def not_done(self, robot: str, since: float) -> list[str]:
        """The skills of a robot of which no command that was asked for since has been done."""
        done = {
            command.skill
            for command in self.all
            if command.robot == robot and command.asked_at >= since and command.outcome is Outcome.DONE
        }
        return [skill for skill, _ in self._asked.get(robot, ()) if skill not in done]

    def done_between(self, robot: str, since: float, until: float) -> int:
        """How many commands of a robot were asked for and done in a time."""
        return sum(
            command.robot == robot and since <= command.asked_at < until and command.outcome is Outcome.DONE
            for command in self.all
        )

    async def run(self) -> None:
        """Work until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            for robot in self._asked:
                tasks.create_task(self._ask_on(robot, tasks))
            tasks.create_task(self._look_on())

    async def _ask_on(self, robot: str, tasks: asyncio.TaskGroup) -> None:
        count = 0
        while True:
            await self._go.wait()
            client = await self._watcher.connected()
            skill, arguments = self._asked[robot][count % len(self._asked[robot])]
            self._busy += 1
            try:
                await self._ask(client, robot, skill, arguments(count), tasks)
            finally:
                self._busy -= 1
            count += 1
            await asyncio.sleep(PAUSE_S)

    async def _ask(
        self, client: FleetClient, robot: str, skill: str, arguments: Mapping[str, Any], tasks: asyncio.TaskGroup
    ) -> None:
        within_s = self._config.robots[robot].skills[skill].timeout_s
        command = Command(robot, skill, time.time(), within_s=within_s)
        self.all.append(command)
        try:
            execution = await client.start_skill(robot, skill, **arguments)
        except (SkillRejected, RobotOffline, AccessRefused) as error:
            self._end(command, Outcome.REFUSED, str(error))
            return
        except (NotConnected, SendTimeout) as error:
            self._end(command, Outcome.UNANSWERED, str(error))
            return
        command.execution_id, command.outcome = execution.id, Outcome.OPEN
        following = tasks.create_task(self._follow(command, execution))
        await asyncio.wait([following], timeout=PATIENCE_S)

    async def _follow(self, command: Command, execution: SkillExecution) -> None:
        try:
            await execution.result()
        except SkillRejected as error:
            self._end(command, Outcome.REFUSED, str(error))
        except SkillFailed as error:
            is_unknown = quality_of(error.ua_status) is Quality.UNCERTAIN
            self._end(command, Outcome.UNKNOWN if is_unknown else Outcome.FAILED, str(error))
        except (NotConnected, SkillTimeout):
            pass  # SkillStatus tells it, or nobody does
        else:
            self._end(command, Outcome.DONE, "")

    def _end(self, command: Command, outcome: Outcome, message: str) -> None:
        if command.outcome in (Outcome.OPEN, Outcome.UNANSWERED):
            command.outcome, command.ended_at, command.message = outcome, time.time(), message

    async def _look_on(self) -> None:
        """Read SkillStatus for ends that were told while this client was not connected."""
        while True:
            await asyncio.sleep(LOOK_S)
            client = self._watcher.client
            if client is None:
                continue
            for robot in {command.robot for command in self.open() if time.time() - command.asked_at > LOOK_S}:
                try:
                    await self._look(client, robot)
                except UaFleetError:
                    break

    async def _look(self, client: FleetClient, robot: str) -> None:
        id_ = self._config.robots[robot].skill_status_id
        ids, states = await client.read([f"ns=2;s={id_}.{name}" for name in ("ExecutionId", "State")])
        if ids.status or states.status:
            return
        shown = dict(zip(map(_hex, ids.value or ()), states.value or (), strict=False))
        for command in self.open():
            outcome = _ENDS.get(ExecutionState(shown[command.execution_id])) if command.execution_id in shown else None
            if outcome is not None:
                self._end(command, outcome, "as SkillStatus tells")


def _hex(value: bytes | str) -> str:
    return value.hex() if isinstance(value, bytes) else value
