"""Methods of skills: what is asked of a robot is checked here, then requested; nothing waits for the robot.

Start    checks arguments, limits and whether the robot is heard; gives the execution's id
Reset    makes a halted skill Ready; the robot is not asked
Halt     asks the robot to stop all that it does for this skill; Bad_NotSupported where its driver cannot
Suspend  asks the robot to stand in the middle of all that it does for this skill, as Halt
Resume   asks it to go on with what it stands in

Roles are looked after before, by the endpoint: an operator may call all of them.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple, Protocol

import structlog
from asyncua import ua

from ua_fleet.endpoint.convert import node_id
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.stack import GOOD, Refusal, StatusCodes, status
from ua_fleet.errors import LocalWireError, NotAnnounced, RobotBusy, RobotOffline
from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.skills import SkillModel, argument_problem
from ua_fleet.nodes.skill_nodes import SHARED_METHODS
from ua_fleet.operation.skills.addressing import NamedArguments
from ua_fleet.operation.skills.program import ProgramState
from ua_fleet.operation.skills.tracker import SkillChange, SkillKeys, SkillTracker
from ua_fleet.skill.executions import EXECUTION_ID_BYTES
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId, status_name
from ua_fleet.wire.packed_fields import pack_fields

__all__ = ["SkillMethods", "SkillRequests"]

_log: Any = structlog.get_logger("ua_fleet.server")

_INVALID: Final = StatusCodes.BadInvalidArgument
_ANNOUNCED_WITHIN_S: Final = 2.0
"""A bridge is asked to announce a skill's Action when the server learns of the skill. So long after that a Start waits
for the answer, and what its client asks for meanwhile waits with it; later nobody waits for a bridge that is away."""
_LOOK_S: Final = 0.05


class SkillRequests(Protocol):
    """What asks robots; see `server.commands_out.SkillCommands`."""

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        """Have a robot do a skill, once, and wait for nothing."""
        ...

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot stop an execution."""
        ...

    def suspend_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot stand in the middle of an execution."""
        ...

    def resume_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot go on with an execution."""
        ...


class MethodLinks(Protocol):
    """What lets Methods be called; asyncua's Server."""

    def link_method(self, node: Any, callback: Callable[..., Any]) -> None:
        """Have a Method's node call this."""
        ...

    def get_node(self, nodeid: Any) -> Any:
        """A node."""
        ...


class _Offered(NamedTuple):
    robot: RobotModel
    skill: SkillModel
    key: NodeId
    topic: Topic


class SkillMethods:
    """Answers the Methods of all skills."""

    def __init__(
        self,
        server: MethodLinks,
        requests: SkillRequests,
        tracker: SkillTracker,
        *,
        put: Callable[[Iterable[SkillChange]], None],
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
        driven_by: Callable[[str], str] = lambda _robot: "",
    ) -> None:
        """Connect the parts; `add` lets a robot's Methods be called.

        Args:
            server: whose Methods they are.
            requests: asks robots.
            tracker: what is known of executions.
            put: shows changes.
            clock: monotonic seconds.
            wall_ticks: the wall clock.
            driven_by: why a robot does no skill now, since people drive it by hand, in words; empty where it may.
        """
        self._driven_by = driven_by
        self._server, self._requests, self._tracker = server, requests, tracker
        self._put, self._clock, self._wall_ticks = put, clock, wall_ticks
        self._skills: dict[ua.NodeId, _Offered] = {}
        self._since: dict[NodeId, float] = {}
        """When the server learned of a skill."""
        self._free_at: dict[NodeId, float] = {}
        """When a skill may be asked for again."""
        calls = {"Suspend": self._suspend, "Resume": self._resume, "Halt": self._halt, "Reset": self._reset}
        for name, method in SHARED_METHODS.items():
            server.link_method(server.get_node(method), calls[name])

    def add(self, robot: RobotModel) -> None:
        """Let the skills of a robot be called; its nodes are there."""
        if robot.skill_status is None:
            return
        for skill in robot.skills:
            keys = SkillKeys(robot.ns, skill.id)
            topic = Topic(robot.skill_status.space, robot.ns, skill.id)
            self._skills[node_id(keys.object)] = _Offered(robot, skill, keys.object, topic)
            self._since[keys.object] = self._clock()
            self._server.link_method(self._server.get_node(node_id(keys.part("Start"))), self._start)

    def remove(self, robot: RobotModel) -> None:
        """Let the skills of a robot not be called any more."""
        for skill in robot.skills:
            key = SkillKeys(robot.ns, skill.id).object
            self._skills.pop(node_id(key), None)
            self._since.pop(key, None)

    async def _start(self, parent: ua.NodeId, *arguments: ua.Variant) -> Any:
        offered = self._offered(parent)
        robot, skill, key, _ = offered
        given = tuple([argument.Value for argument in arguments])
        problems = [argument_problem(declared, value) for declared, value in zip(skill.arguments, given, strict=True)]
        if any(problems):
            reason = "; ".join(problem for problem in problems if problem)
            _log.warning("skill not started", robot=robot.name, skill=skill.name, reason=reason)
            result = ua.CallMethodResult()
            result.StatusCode = status(_INVALID)
            result.InputArgumentResults = [
                GOOD if problem is None else status(_code_of(value))
                for problem, value in zip(problems, given, strict=True)
            ]
            return result
        try:
            execution_id = await self._requested(offered, given)
        except Exception as error:
            if (code := getattr(error, "ua_status", None)) is not None:
                reason = f"{status_name(code)}: {error}"
                _log.warning("skill not started", robot=robot.name, skill=skill.name, reason=reason)
            raise
        self._free_at[key] = self._clock() + skill.limits.least_interval_s
        self._put(self._tracker.requested(key, execution_id, self._wall_ticks()))
        return [ua.Variant(execution_id.hex(), ua.VariantType.String)]

    async def _requested(self, offered: _Offered, given: tuple[Any, ...]) -> bytes:
        """Ask the robot, once its Action is announced; what may be asked is looked at each time. The execution's id."""
        robot, skill, key, topic = offered
        execution_id = secrets.token_bytes(EXECUTION_ID_BYTES)
        session = current_session.get()
        link, user = (None, None) if session is None else (session.link, session.user)
        while True:
            named = self._checked(offered, given)
            try:
                self._requests.request(topic, robot.name, skill.name, named, skill.timeout_s, execution_id)
            except NotAnnounced:
                if self._clock() >= self._since.get(key, 0.0) + _ANNOUNCED_WITHIN_S:
                    raise
                await asyncio.sleep(_LOOK_S)
                # Nothing moves for somebody who has gone meanwhile, or may no more.
                if session is None or link is None or user is None:
                    continue
                if (refusal := session.refusal(link, user)) is not None:
                    raise refusal from None
            else:
                return execution_id

    def _checked(self, offered: _Offered, given: tuple[Any, ...]) -> NamedArguments:
        """The arguments by their names; raises Refusal for what the skill's limits, or its robot, do not allow now."""
        skill, limits = offered.skill, offered.skill.limits
        try:
            packed = pack_fields(tuple([argument.type for argument in skill.arguments]), given)
        except LocalWireError as error:
            raise Refusal(_INVALID, str(error)) from error
        if (size := len(packed.content)) > limits.largest_message_bytes:
            raise Refusal(StatusCodes.BadRequestTooLarge, f"{size} bytes of {limits.largest_message_bytes}")
        if self._tracker.is_silent(offered.key):
            raise RobotOffline(f"robot {offered.robot.name} is silent; check that its bridge, or its client, runs")
        if driven := self._driven_by(offered.robot.name):
            raise RobotBusy(f"robot {offered.robot.name} does no skill now: it is {driven}")
        self._put(self._tracker.expire(offered.key, self._wall_ticks()))
        if self._tracker.under_way(offered.key) >= limits.requests_at_once:
            raise Refusal(StatusCodes.BadTooManyOperations, f"{limits.requests_at_once} executions are under way")
        if self._clock() < self._free_at.get(offered.key, 0.0):
            said = f"asked for again within {limits.least_interval_s:g} s"
            raise Refusal(StatusCodes.BadServerTooBusy, said)
        return NamedArguments([argument.name for argument in skill.arguments], packed)

    async def _reset(self, parent: ua.NodeId) -> list[ua.Variant]:
        offered = self._offered(parent)
        if self._tracker.state(offered.key) is not ProgramState.HALTED:
            raise Refusal(StatusCodes.BadInvalidState, f"{offered.skill.name} is not halted")
        self._put(self._tracker.reset(offered.key, self._wall_ticks()))
        return []

    async def _halt(self, parent: ua.NodeId) -> list[ua.Variant]:
        robot, skill, key, topic = self._offered(parent)
        executions = self._tracker.open_executions(key)
        if not executions:
            raise Refusal(StatusCodes.BadInvalidState, f"{skill.name} is not under way")
        for execution_id in executions:
            self._requests.halt(topic, robot.name, execution_id)
        return []

    async def _suspend(self, parent: ua.NodeId) -> list[ua.Variant]:
        robot, skill, key, topic = self._offered(parent)
        executions = self._tracker.running_executions(key)
        if not executions:
            raise Refusal(StatusCodes.BadInvalidState, f"{skill.name} is not running")
        for execution_id in executions:
            self._requests.suspend_execution(topic, robot.name, execution_id)
        return []

    async def _resume(self, parent: ua.NodeId) -> list[ua.Variant]:
        robot, skill, key, topic = self._offered(parent)
        executions = self._tracker.suspended_executions(key)
        if not executions:
            raise Refusal(StatusCodes.BadInvalidState, f"{skill.name} is not suspended")
        for execution_id in executions:
            self._requests.resume_execution(topic, robot.name, execution_id)
        return []

    def _offered(self, parent: ua.NodeId) -> _Offered:
        offered = self._skills.get(parent)
        if offered is None:
            # The type has the Methods too, but nothing behind them.
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no skill")
        return offered


def _code_of(value: Any) -> int:
    return int(StatusCodes.BadTypeMismatch if value is None else StatusCodes.BadOutOfRange)
