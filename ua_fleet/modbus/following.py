"""How a command goes on, asked of the server by its id: so it can be followed after any restart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from ua_fleet.client import FleetClient, NodeNotFound, ScenarioClient
from ua_fleet.config.schema import FleetConfig
from ua_fleet.modbus.words import CommandState
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import read_result
from ua_fleet.values import Quality, StatusCode, quality_of

__all__ = ["Followed", "Patience", "follow_run", "follow_skill"]

_STATES: Final = {
    ExecutionState.REFUSED: CommandState.REFUSED,
    ExecutionState.TIMED_OUT: CommandState.REFUSED,
    ExecutionState.RUNNING: CommandState.RUNNING,
    ExecutionState.DONE: CommandState.DONE,
    ExecutionState.FAILED: CommandState.FAILED,
    ExecutionState.UNKNOWN: CommandState.UNKNOWN,
    ExecutionState.ASKING: CommandState.RUNNING,
    ExecutionState.SUSPENDED: CommandState.RUNNING,
}
_FIELDS: Final = ("ExecutionId", "State", "Progress", "Result", "Message", "Status")
_GRACE_S: Final = 10.0
"""So long after the skill's timeout a robot that is silent may still tell of the end."""


class Followed(NamedTuple):
    """What is known of a command now."""

    state: CommandState
    progress: float = 0.0
    status: int = 0
    message: str = ""
    """About its end; or why nobody tells of it."""
    results: Mapping[str, Any] = {}
    patience_s: float | None = None
    """So long it is believed to run although nobody tells of it; None where it is told of."""


class Patience:
    """How long one command of which nobody tells is believed to run. Pure."""

    def __init__(self) -> None:
        self._since: float | None = None

    def is_over(self, followed: Followed, now: float) -> bool:
        """Whether it was not told of for too long by now (s, monotonic); ask after each look."""
        if followed.patience_s is None:
            self._since = None
            return False
        if self._since is None:
            self._since = now
        return now - self._since > followed.patience_s


async def follow_skill(client: FleetClient, config: FleetConfig, robot: str, skill: str, execution_id: str) -> Followed:
    """An execution, by the robot's SkillStatus.

    A robot that is heard and does not tell of it gets the time of two repeats, since it may just have been told; after
    that it has begun so many others that it does not come back to this one. A silent robot gets the time of the skill.
    """
    its = config.robots[robot]
    silence_s = its.skills[skill].timeout_s + _GRACE_S
    node = f"ns={its.namespace};s={its.skill_status_id}"
    try:
        readings = await client.read([f"{node}.{field}" for field in _FIELDS])
    except NodeNotFound:
        return Followed(CommandState.RUNNING, message="the server has no such robot now", patience_s=silence_s)
    *columns, codes = [list(reading.value or ()) for reading in readings]
    is_heard = quality_of(readings[0].status) is Quality.GOOD
    wanted = execution_id.replace("-", "").lower()
    for place, (shown, state, progress, result, message) in enumerate(zip(*columns, strict=False)):
        if str(shown).replace("-", "").lower() == wanted and state in _STATES:
            told = Followed(
                _STATES[state],
                float(progress or 0.0),
                _code(codes[place] if place < len(codes) else 0),
                str(message or ""),
                read_result(str(result or "")),
            )
            if is_heard or told.state is not CommandState.RUNNING:
                return told
            return told._replace(message="the robot is silent; look at it", patience_s=silence_s)
    if is_heard:
        patience_s = 2 * config.pubsub.repeat_interval_s + 1
        return Followed(CommandState.RUNNING, message="the robot tells no more of it", patience_s=patience_s)
    return Followed(CommandState.RUNNING, message="the robot is silent; look at it", patience_s=silence_s)


def _code(code: Any) -> int:
    return int(code) if isinstance(code, int) else int(StatusCode.UNCERTAIN)


async def follow_run(scenarios: ScenarioClient, run_id: str) -> Followed:
    """A run of a scenario."""
    try:
        run = await scenarios.run_info(run_id)
    except NodeNotFound:
        text = "the server has forgotten the run; look at its audit log"
        return Followed(CommandState.UNKNOWN, 0.0, int(StatusCode.UNCERTAIN), text)
    if not run.is_over:
        over = sum(state in ("done", "failed", "skipped") for state in run.states)
        return Followed(CommandState.RUNNING, over / max(len(run.states), 1))
    if run.state == "done":
        return Followed(CommandState.DONE, 1.0)
    return Followed(CommandState.FAILED, 0.0, int(StatusCode.BAD_UNEXPECTED_ERROR), f"{run.state}: {run.reason}")
