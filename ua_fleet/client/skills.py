# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Skills of robots, called as Python functions are: with arguments by name, and results or an error in the end.

    results = await client.call_skill("arm", "turn", angle=20)

    execution = await client.start_skill("arm", "turn", angle=20)
    async for event in execution.events():
        print(event.transition)
    results = await execution.result()

Events come by one subscription to the Server object, made before the first Start, so that no end is missed.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import Client, Node, ua
from asyncua.common.subscription import Subscription

from ua_fleet.client.batches import Batches
from ua_fleet.client.convert import plain_value
from ua_fleet.client.skill_nodes import (
    KnownSkill,
    SkillArgument,
    SkillInfo,
    SkillNode,
    is_as_known,
    read_skills,
    skill_nodes,
)
from ua_fleet.client.subscriptions import subscribe
from ua_fleet.client.translated import NodeNotFound, translated
from ua_fleet.errors import AccessRefused, NotConnected, RobotOffline, SkillFailed, SkillRejected, SkillTimeout
from ua_fleet.topics import TYPES_URI
from ua_fleet.values import Quality, StatusCode, is_finite, quality_of

__all__ = ["SkillArgument", "SkillCalls", "SkillEvent", "SkillExecution", "SkillInfo", "fitting"]

_EVENT_TYPE: Final = 1011
"""SkillTransitionEventType; see nodesets/UaFleet.NodeIds.csv."""
_EARLY: Final = 1000
"""Events that are kept for executions whose Start has not been answered yet."""
_QUEUE: Final = 10_000
_END_TOLD_S: Final = 10.0
"""What takes too long is told to stop, and its robot has 5 s to say that it stands: its end comes after its timeout."""
_INTEGERS: Final = range(ua.VariantType.SByte.value, ua.VariantType.UInt64.value + 1)
_REASONS: Final = {
    ua.StatusCodes.BadTooManyOperations: "the highest number of executions is under way",
    ua.StatusCodes.BadServerTooBusy: "it was requested a moment ago; try again later",
    ua.StatusCodes.BadRequestTooLarge: "the arguments are too large",
    ua.StatusCodes.BadNotExecutable: "clients of this server may not use it",
    ua.StatusCodes.BadNotSupported: "the robot does not support that",
    ua.StatusCodes.BadInvalidState: "the skill's state does not allow that; see: ua-fleet skill list",
    ua.StatusCodes.BadResourceUnavailable: "the server cannot record it; see its log",
}


@dataclass(frozen=True, slots=True)
class SkillEvent:
    """A transition of an execution."""

    execution_id: str
    transition: str
    """E.g. `ReadyToRunning`."""
    state: str
    """The state after it."""
    is_over: bool
    status: int
    message: str
    time: datetime
    results: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def status_text(self) -> str:
        """Name of the StatusCode."""
        return str(ua.StatusCode(ua.UInt32(self.status)).name)


class SkillExecution:
    """One execution that this client has started. Its end and its results are kept."""

    def __init__(
        self,
        robot: str,
        skill: str,
        execution_id: str,
        timeout_s: float,
        endpoint: str,
        members: Mapping[str, str] | None = None,
    ) -> None:
        self.robot, self.skill, self.id = robot, skill, execution_id
        self.members: Mapping[str, str] = members or {}
        """NodeIds of the skill's Variables and Methods, by their names."""
        self.timeout_s = timeout_s
        """So long the skill may take."""
        self.longest_wait_s = timeout_s + _END_TOLD_S
        """Until then its end has been told, that it took too long too."""
        self._endpoint = endpoint
        self._seen: list[SkillEvent] = []
        self._changed = asyncio.Event()
        self._is_lost = False

    @property
    def is_over(self) -> bool:
        """Whether its end has been told."""
        return bool(self._seen) and self._seen[-1].is_over

    def put(self, event: SkillEvent) -> None:
        """Take an event of it."""
        self._seen.append(event)
        self._changed.set()

    def lose(self) -> None:
        """No more events will come."""
        self._is_lost = True
        self._changed.set()

    async def events(self) -> AsyncGenerator[SkillEvent]:
        """All its events, those that were told before first; ends with its end.

        Raises:
            NotConnected: the connection was lost before.
        """
        told = 0
        while True:
            while told < len(self._seen):
                event = self._seen[told]
                told += 1
                yield event
                if event.is_over:
                    return
            if self._is_lost:
                raise NotConnected(
                    f"the connection to {self._endpoint} was lost; execution {self.id} of {self.robot}.{self.skill} "
                    "goes on without this command"
                )
            self._changed.clear()
            await self._changed.wait()

    async def result(self, *, timeout_s: float | None = None) -> dict[str, Any]:
        """Wait for its end; the results by name. May be asked for again.

        Raises:
            SkillRejected: the robot refused it, or heard of it too late; it was not begun.
            SkillFailed: it was begun and did not succeed; with an Uncertain `ua_status` nobody knows.
            SkillTimeout: it did not end within `timeout_s`. The robot goes on.
            NotConnected: the connection was lost before.
        """
        try:
            async with asyncio.timeout(timeout_s):
                async for event in self.events():
                    if event.is_over:
                        return self._results(event)
        except TimeoutError:
            raise SkillTimeout(
                f"{self.robot}.{self.skill} did not end within {timeout_s:g} s; execution {self.id} goes on"
            ) from None
        raise AssertionError("events end with an end")

    def _results(self, event: SkillEvent) -> dict[str, Any]:
        if quality_of(event.status) is Quality.GOOD:
            return dict(event.results)
        name = f"{self.robot}.{self.skill}: "
        reason = event.message.removeprefix(name).removeprefix(event.transition).removeprefix("; ")
        said = f"{name}{reason or event.status_text}"
        error = SkillRejected(said) if event.state == "Ready" else SkillFailed(said)
        error.ua_status = event.status
        raise error


class SkillCalls:
    """What `FleetClient` does with skills."""

    def __init__(self, client: Client, find: Callable[[str], Awaitable[Node]], batches: Batches, endpoint: str) -> None:
        self._client, self._find, self._batches, self._endpoint = client, find, batches, endpoint
        self._known: dict[tuple[str, str], KnownSkill] = {}
        self._running: dict[str, SkillExecution] = {}
        self._early: OrderedDict[str, list[SkillEvent]] = OrderedDict()
        self._subscribing = asyncio.Lock()
        self._is_subscribed = False

    def lost(self) -> None:
        """The connection is gone."""
        for execution in self._running.values():
            execution.lose()
        self._running.clear()

    async def all_of(self, robot: str) -> list[SkillInfo]:
        """See FleetClient.skills."""
        with translated(self._endpoint):
            folder = await self._find(f"Fleet/Robots/{robot}/Skills")
            return await self.all_at(await skill_nodes(self._batches, [(robot, folder.nodeid)]))

    async def nodes_of(self, robots: Mapping[str, ua.NodeId]) -> list[SkillNode]:
        """Where the skills of some robots stand, given with their nodes."""
        with translated(self._endpoint):
            skills = await self._batches.browse(list(robots.values()), classes=int(ua.NodeClass.Object))
            folders = [
                (robot, child.NodeId)
                for robot, children in zip(robots, skills, strict=True)
                for child in children
                if child.BrowseName.Name == "Skills"
            ]
            return await skill_nodes(self._batches, folders)

    async def all_at(self, nodes: Sequence[SkillNode]) -> list[SkillInfo]:
        """The skills that stand there."""
        with translated(self._endpoint):
            return [known.info for known in await read_skills(self._batches, nodes)]

    async def start(self, robot: str, skill: str, arguments: Mapping[str, Any]) -> SkillExecution:
        """See FleetClient.start_skill."""
        with translated(self._endpoint, f"{robot}.{skill}: "):
            known = await self._as_it_is(robot, skill)
            values = _values(known, arguments)
            await self._subscribe()
            object_id = ua.NodeId.from_string(known.info.node_id)
            (result,) = await self._client.uaclient.call([ua.CallMethodRequest(object_id, known.start, values)])
        _check(known, result)
        execution_id = str(result.OutputArguments[0].Value)
        members = {name: node.to_string() for name, node in known.members.items()}
        execution = SkillExecution(robot, skill, execution_id, known.info.timeout_s, self._endpoint, members)
        self._running[execution_id] = execution
        for event in self._early.pop(execution_id, ()):
            self._deliver(execution, event)
        return execution

    async def control(self, robot: str, skill: str, method: str) -> None:
        """See FleetClient.halt_skill, suspend_skill and resume_skill."""
        with translated(self._endpoint, f"{robot}.{skill}: "):
            known = await self._as_it_is(robot, skill)
            object_id = ua.NodeId.from_string(known.info.node_id)
            request = ua.CallMethodRequest(object_id, known.members[method], [])
            (result,) = await self._client.uaclient.call([request])
        _check(known, result)

    def event_notification(self, event: Any) -> None:
        """Called by asyncua with each event."""
        told = SkillEvent(
            str(event.ExecutionId),
            str(event.Transition.Text),
            str(event.ToState.Text),
            bool(event.IsOver),
            int(event.Status.value),
            str(event.Message.Text or ""),
            event.Time if event.Time.tzinfo is not None else event.Time.replace(tzinfo=UTC),
            {
                name: plain_value(variant.Value)
                for name, variant in zip(event.ResultNames or (), event.Results or (), strict=False)
            },
        )
        execution = self._running.get(told.execution_id)
        if execution is not None:
            self._deliver(execution, told)
            return
        self._early.setdefault(told.execution_id, []).append(told)
        while len(self._early) > _EARLY:
            self._early.popitem(last=False)

    def status_change_notification(self, status: ua.StatusChangeNotification) -> None:
        """Called by asyncua when the server ends the subscription."""
        self._is_subscribed = False
        self.lost()

    def _deliver(self, execution: SkillExecution, event: SkillEvent) -> None:
        execution.put(event)
        if event.is_over:
            self._running.pop(execution.id, None)

    async def _subscribe(self) -> None:
        async with self._subscribing:
            if self._is_subscribed:
                return
            index = await self._client.get_namespace_index(TYPES_URI)
            event_type = self._client.get_node(ua.NodeId(ua.Int32(_EVENT_TYPE), ua.Int16(index)))

            def begin(subscription: Subscription) -> Awaitable[object]:
                return subscription.subscribe_events(ua.ObjectIds.Server, event_type, queuesize=_QUEUE)

            await subscribe(self._client, self, 50, begin)
            self._is_subscribed = True

    async def _as_it_is(self, robot: str, skill: str) -> KnownSkill:
        """A skill; read anew where it was offered anew since, perhaps with its arguments in another order."""
        known = self._known.get((robot, skill))
        if known is None or not await is_as_known(self._batches, known):
            known = self._known[robot, skill] = await self._read(robot, skill)
        return known

    async def _read(self, robot: str, skill: str) -> KnownSkill:
        node = await self._find(f"Fleet/Robots/{robot}/Skills/{skill}")
        known = await read_skills(self._batches, [SkillNode(robot, skill, node.nodeid)])
        if not known:
            raise NodeNotFound(f"{robot}.{skill} is no skill; look with: ua-fleet skill list {robot}")
        return known[0]


def _values(known: KnownSkill, given: Mapping[str, Any]) -> list[ua.Variant]:
    """All arguments in their order and types; raises SkillRejected for what is wrong."""
    name = f"{known.info.robot}.{known.info.name}"
    names = [argument.name for argument in known.info.arguments]
    problems = [f"there is no argument {other!r}" for other in given if other not in names]
    wrong: list[str] = []
    values: list[ua.Variant] = []
    for argument in known.info.arguments:
        value = given.get(argument.name, argument.default)
        if value is None:
            problems.append(f"the argument {argument.name!r} is missing")
            wrong.append(argument.name)
            continue
        kind = known.types[argument.name]
        fitted = fitting(value, kind)
        if fitted is None:
            problems.append(f"{argument.name} is {value!r}, and no {kind.name}")
            wrong.append(argument.name)
            continue
        values.append(ua.Variant(fitted, kind))
    if problems:
        takes = f"; it takes {', '.join(names)}" if names else "; it takes none"
        raise _rejected(StatusCode.BAD_INVALID_ARGUMENT, f"{name}: {'; '.join(problems)}{takes}", wrong)
    return values


def fitting(value: Any, kind: ua.VariantType) -> Any:
    """A value as one of a type, or None."""
    if kind is ua.VariantType.Boolean:
        return value if isinstance(value, bool) else None
    if kind is ua.VariantType.String:
        return value if isinstance(value, str) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not is_finite(value):
        return None
    if kind.value not in _INTEGERS:
        return float(value)
    if value != int(value):
        return None
    bits = 8 << ((kind.value - ua.VariantType.SByte.value) // 2)
    is_signed = kind.value % 2 == 0
    least, greatest = (-(1 << bits - 1), (1 << bits - 1) - 1) if is_signed else (0, (1 << bits) - 1)
    return int(value) if least <= value <= greatest else None


def _check(known: KnownSkill, result: ua.CallMethodResult) -> None:
    """Raise the error that a refused call is."""
    code = int(result.StatusCode.value)
    if quality_of(code) is Quality.GOOD:
        return
    name, text = f"{known.info.robot}.{known.info.name}", str(result.StatusCode.name)
    if code == StatusCode.BAD_USER_ACCESS_DENIED:
        raise AccessRefused(code, f"{name}: {text}: this user may not command robots; see: ua-fleet user list")
    if code == StatusCode.BAD_NO_COMMUNICATION:
        raise RobotOffline(f"{name}: the robot is silent; check that its bridge, or its client, runs")
    wrong = {
        argument.name: f"{argument.name}: {outcome.name} ({argument.description})"
        for argument, outcome in zip(known.info.arguments, result.InputArgumentResults or (), strict=False)
        if not outcome.is_good()
    }
    raise _rejected(code, f"{name}: {'; '.join(wrong.values()) or _REASONS.get(code, text)}", list(wrong))


def _rejected(code: int, text: str, wrong: Sequence[str]) -> SkillRejected:
    error = SkillRejected(text)
    error.ua_status = int(code)
    error.argument = wrong[0] if len(wrong) == 1 else ""
    return error
