"""What the log says of a bridge's executions: one line when one begins, one when it ends."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, Final

from ua_fleet.skill.executions import OPEN, ExecutionState
from ua_fleet.skill.journal import RecordedExecution
from ua_fleet.values import status_name

__all__ = ["ExecutionLog"]

_MOST_REMEMBERED: Final = 1000


class ExecutionLog:
    """Is told of each execution whose state is new."""

    def __init__(self, log: Any) -> None:
        """Begin with nothing said; `log` is a logger of structlog."""
        self._log = log
        self._states: OrderedDict[bytes, ExecutionState] = OrderedDict()

    def take(self, execution: RecordedExecution, robot: str, skill: str) -> None:
        """An execution is new or has a new state."""
        report = execution.report
        before = self._states.get(execution.execution_id)
        if before is report.state:
            return
        self._states[execution.execution_id] = report.state
        if len(self._states) > _MOST_REMEMBERED:
            self._states.popitem(last=False)
        ids = {"robot": robot, "skill": skill, "execution_id": execution.execution_id.hex()}
        if report.state is ExecutionState.RUNNING:
            text = "execution begins" if before is None else "execution goes on"
            self._log.info(text, **ids, requestor=execution.requestor_id)
        elif report.state is ExecutionState.SUSPENDED:
            self._log.info("execution suspended", **ids)
        elif report.state is ExecutionState.ASKING:
            self._log.warning("the robot is asked what became of an execution", **ids)
        elif report.state not in OPEN:
            tell = self._log.info if report.state is ExecutionState.DONE else self._log.warning
            said = {"status": status_name(report.status)} if report.status else {}
            if report.message:
                said["reason"] = report.message
            tell("execution ended", **ids, outcome=report.state.name.lower(), **said)
