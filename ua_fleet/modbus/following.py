"""How a command goes on, asked of the server by its id: so it can be followed after any restart."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from ua_fleet.client import FleetClient, NodeNotFound, ScenarioClient
from ua_fleet.modbus.words import CommandState
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.values import StatusCode

__all__ = ["Followed", "follow_run", "follow_skill"]

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


class Followed(NamedTuple):
    """What is known of a command now."""

    state: CommandState
    progress: float = 0.0
    status: int = 0
    message: str = ""
    results: Mapping[str, Any] = {}


async def follow_skill(client: FleetClient, namespace: int, status_id: int, execution_id: str) -> Followed:
    """An execution, by the robot's SkillStatus.

    Where it is not there (the robot is not heard, or has not been told yet) it counts as running: the server gives up
    what takes too long, and says so there.
    """
    readings = await client.read([f"ns={namespace};s={status_id}.{field}" for field in _FIELDS])
    ids, states, progress, results, messages, codes = [list(reading.value or ()) for reading in readings]
    wanted = execution_id.replace("-", "").lower()
    for place, shown in enumerate(ids):
        if str(shown).replace("-", "").lower() == wanted:
            code = codes[place] if place < len(codes) else 0
            state = _STATES[ExecutionState(states[place])]
            text = results[place]
            values: dict[str, Any] = json.loads(text) if text else {}
            return Followed(state, float(progress[place]), _code(code), str(messages[place] or ""), values)
    return Followed(CommandState.RUNNING)


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
