"""The skills of nodes/skilled.py, and a bridge with a requestor of commands that use them."""

from __future__ import annotations

import secrets
import signal
from typing import Any, Final

from tests.integration.actions.requesting import Requesting
from tests.integration.ros1.ros1_graph import Ros1Graph
from tests.system import Child
from tests.waiting import until
from ua_fleet.skill.executions import OPEN, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.skill.status import read_result
from ua_fleet.topics import Topic

SPACE: Final = 1
DRIVE, MOVE, HOLD, FAIL, NO, COUNT = 1010, 1011, 1012, 1013, 1014, 1015
STATUS: Final = 1000

SKILLS: dict[str, Any] = {
    "drive": {
        "id": DRIVE,
        "arguments": {"to": {"type": "String"}, "seconds": {"type": "Double", "default": 0.0}},
        "results": {"distance": {"type": "Double"}},
        "timeout_s": 10.0,
    },
    "move": {
        "id": MOVE,
        "arguments": {"speed": {"type": "Double"}},
        "timeout_s": 2.0,
        "via": {
            "topic": {
                "topic": "/move",
                "type": "geometry_msgs/Twist",
                "fields": {"speed": "linear.x"},
                "constants": {"angular.z": 0.5},
                "halt": {},
                "status": {
                    "topic": "/move_state",
                    "type": "std_msgs/String",
                    "running": "data == 'moving'",
                    "done": "data == 'arrived'",
                    "failed": "data == 'stuck'",
                    "message": "data",
                },
            }
        },
    },
    "hold": {
        "id": HOLD,
        "arguments": {"data": {"type": "Boolean"}},
        "timeout_s": 1.0,
        "via": {"service": {"name": "/hold", "type": "std_srvs/SetBool", "success": "success", "message": "message"}},
    },
    "fail": {"id": FAIL, "timeout_s": 5.0, "via": {"service": {"name": "/fail", "type": "std_srvs/Trigger"}}},
    "no": {
        "id": NO,
        "timeout_s": 5.0,
        "via": {"service": {"name": "/no", "type": "std_srvs/Trigger", "success": "success", "message": "message"}},
    },
    "count": {
        "id": COUNT,
        "arguments": {"tenths": {"type": "Int32"}},
        "results": {"counted": {"type": "Int32"}},
        "timeout_s": 60.0,
        "via": {
            "action": {
                "name": "/count",
                "type": "actionlib/Test",
                "fields": {"tenths": "goal"},
                "results": {"counted": "result"},
                "progress": "feedback / arguments.tenths",
            }
        },
    },
}
ROBOTS: dict[str, Any] = {"arm": {"bridge": "ros1", "skill_status_id": STATUS, "skills": SKILLS}}


class Robot:
    """A robot with skills, its bridge, and who commands it."""

    def __init__(self, graph: Ros1Graph, requestor: Requesting) -> None:
        self.graph, self._requestor = graph, requestor
        self.bridge = graph.bridge(ROBOTS)
        self.node: Child = graph.node("skilled.py")
        self._status = Topic(SPACE, 2, STATUS)

    def told(self) -> list[str]:
        """What the robot was told, without the ids of goals."""
        told = [line.removeprefix("told: ") for line in self.node.lines if line.startswith("told: ")]
        return [" ".join(word for word in line.split() if len(word) < 32) for line in told]

    async def ask(self, skill: int, *values: Any, execution_id: bytes | None = None) -> RequestOutcome:
        topic = Topic(SPACE, 2, skill)
        return await self._requestor.invoke(topic, values, 20.0, execution_id)

    async def begin(self, skill: int, *values: Any) -> bytes:
        """Have it begin something, and wait until it was told."""
        execution_id, before = secrets.token_bytes(16), len(self.told())
        outcome = await self.ask(skill, *values, execution_id=execution_id)
        assert outcome.kind is OutcomeKind.ACCEPTED, outcome
        await until(lambda: len(self.told()) > before)
        return execution_id

    def seen(self, execution_id: bytes) -> tuple[ExecutionState, dict[str, Any], str] | None:
        """State, results and message of an execution in SkillStatus."""
        message = self._requestor.status.get(self._status)
        if message is None or not message.values:
            return None
        ids, _skills, states, _progress, results, messages, _ = message.values
        for number, one in enumerate(ids):
            if one == execution_id:
                return ExecutionState(states[number]), read_result(results[number]), messages[number]
        return None

    def has_ended(self, execution_id: bytes) -> bool:
        seen = self.seen(execution_id)
        return seen is not None and seen[0] not in OPEN

    async def end(self, execution_id: bytes) -> tuple[ExecutionState, dict[str, Any], str]:
        await until(lambda: self.has_ended(execution_id))
        seen = self.seen(execution_id)
        assert seen is not None
        return seen

    async def do(self, skill: int, *values: Any) -> tuple[ExecutionState, dict[str, Any], str]:
        """Have it do something; how it ended."""
        return await self.end(await self.begin(skill, *values))

    def halt(self, skill: int, execution_id: bytes) -> None:
        self._requestor.commands.halt(Topic(SPACE, 2, skill), "arm", execution_id)

    async def outcome(self, execution_id: bytes) -> RequestOutcome:
        """What became of a request, as a halt."""
        return await self._requestor.outcome(execution_id)

    def restart_bridge(self) -> None:
        """Kill the bridge and start it anew."""
        self.bridge.end(signal.SIGKILL)
        self._requestor.status.clear()
        self.bridge = self.graph.bridge(ROBOTS)
