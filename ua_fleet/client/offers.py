# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Skills that this client does: a person, or a program without a bridge.

    async with client.offer_skill("mechanic", "call_mechanic", definition) as offered:
        async for request in offered:
            await request.accept()
            await request.complete({"fixed": True})

The offer lasts as long as the context and the connection. To scenarios and other clients it is a robot's skill.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from asyncua import Client, ua
from asyncua.common.subscription import Subscription

from ua_fleet.client.convert import plain_value
from ua_fleet.client.methods import NotDone, call_method, text, texts
from ua_fleet.client.robots import RobotInvalid
from ua_fleet.client.scenarios import Problem
from ua_fleet.client.subscriptions import Feed, Subscriptions
from ua_fleet.client.translated import translated
from ua_fleet.errors import NotConnected, UaFleetError
from ua_fleet.topics import TYPES_URI

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["OfferedSkill", "SkillRequest", "offering"]

_EVENT: Final = 1030
"""SkillRequestEventType; see nodesets/UaFleet.NodeIds.csv."""
_OFFERS: Final = "Fleet.Offers"
_QUEUE: Final = 10_000
"""Requests that may wait for whoever does them; then the oldest is dropped, and counted in `FleetClient.dropped`."""


class SkillRequest:
    """One execution that is asked for. Its methods raise NotDone where it is over, or another client does it."""

    def __init__(
        self, client: FleetClient, robot: str, skill: str, execution_id: str, given: Mapping[str, Any]
    ) -> None:
        self._client = client
        self.robot, self.skill, self.id = robot, skill, execution_id
        self.arguments = dict(given)
        """By their names."""
        self.is_over = False
        """Whether it has ended, in whatever way."""
        self.halted = asyncio.Event()
        """Set when whoever asked wants it stopped: stop, then call `fail`."""

    async def accept(self) -> None:
        """Do it; no other client does."""
        await self._call("Accept")

    async def report(self, progress: float, message: str = "") -> None:
        """Say how far it is: 0 to 1."""
        await self._call("Report", ua.Variant(float(progress), ua.VariantType.Double), text(message))

    async def complete(self, results: Mapping[str, Any] | None = None, message: str = "") -> None:
        """It is done, with these results."""
        given = results or {}
        values = [value if isinstance(value, str) else json.dumps(value) for value in given.values()]
        await self._call("Complete", texts(list(given)), texts(values), text(message))

    async def fail(self, message: str) -> None:
        """It is not done, and will not be; where nobody has accepted it, for all who offer it."""
        await self._call("Fail", text(message))

    async def _call(self, name: str, *arguments: ua.Variant) -> None:
        (await call_method(self._client, _OFFERS, name, text(self.id), *arguments)).check()


Do = Callable[[SkillRequest], Awaitable[Mapping[str, Any] | None]]


class OfferedSkill(Feed[SkillRequest]):
    """A skill while this client offers it: what it is asked for, one after the other."""

    def __init__(self, client: FleetClient, robot: str, skill: str, endpoint: str) -> None:
        super().__init__(_QUEUE)
        self._client, self._robot, self._skill, self._endpoint = client, robot, skill, endpoint
        self._known: dict[str, SkillRequest] = {}

    def __aiter__(self) -> AsyncIterator[SkillRequest]:
        return self

    async def __anext__(self) -> SkillRequest:
        request = await self.next()
        if request is None:
            raise NotConnected(f"the connection to {self._endpoint} was lost, and with it the offer")
        return request

    async def serve(self, do: Do) -> None:
        """Accept each request and do it, one after the other, until cancelled or the connection is lost.

        Args:
            do: does it and returns the results; what it raises of our errors or as OSError fails the execution alone.
        """
        async for request in self:
            try:
                await request.accept()
            except NotDone:
                continue  # another client was faster, or it is over
            try:
                await request.complete(await do(request))
            except NotConnected:
                raise
            except (UaFleetError, OSError) as error:
                await _say_failed(request, error)

    def event_notification(self, event: Any) -> None:
        """Called by asyncua with each event."""
        if (event.Robot, event.Skill) != (self._robot, self._skill):
            return
        if event.State == "asked":
            values = [plain_value(variant.Value) for variant in event.Arguments or ()]
            self.ask(str(event.ExecutionId), dict(zip(event.ArgumentNames or (), values, strict=True)))
        elif (known := self._known.get(str(event.ExecutionId))) is not None:
            if event.State == "halt":
                known.halted.set()
            elif event.State != "taken":
                known.is_over = True
                del self._known[known.id]

    def ask(self, execution_id: str, arguments: Mapping[str, Any]) -> None:
        """Take a request that is new to us."""
        if execution_id not in self._known:
            request = SkillRequest(self._client, self._robot, self._skill, execution_id, arguments)
            self._known[execution_id] = request
            self.put(request)


async def _say_failed(request: SkillRequest, error: Exception) -> None:
    with contextlib.suppress(NotDone):  # it was given up meanwhile
        await request.fail(str(error).splitlines()[0] if str(error) else type(error).__name__)


@contextlib.asynccontextmanager
async def offering(
    client: FleetClient,
    connection: Client,
    subscriptions: Subscriptions,
    robot: str,
    skill: str,
    definition: str | Mapping[str, Any] = "",
) -> AsyncGenerator[OfferedSkill]:
    """See FleetClient.offer_skill."""
    said = definition if isinstance(definition, str) else json.dumps(definition)
    offered = OfferedSkill(client, robot, skill, client.endpoint)
    with translated(client.endpoint):
        index = await connection.get_namespace_index(TYPES_URI)
        event_type = connection.get_node(ua.NodeId(ua.Int32(_EVENT), ua.Int16(index)))

    def begin(subscription: Subscription) -> Awaitable[object]:
        return subscription.subscribe_events(ua.ObjectIds.Server, event_type, queuesize=_QUEUE)

    async with subscriptions.open(offered, 50, begin):
        done = await call_method(client, _OFFERS, "OfferSkill", text(robot), text(skill), text(said))
        _, problems, lines = done.outputs
        if problems:
            raise RobotInvalid([Problem(line, problem) for line, problem in zip(lines, problems, strict=True)])
        done.check()
        try:
            await _take_open(client, offered, robot, skill)
            yield offered
        finally:
            with contextlib.suppress(UaFleetError):  # a lost connection withdraws it too
                await call_method(client, _OFFERS, "WithdrawSkill", text(robot), text(skill))


async def _take_open(client: FleetClient, offered: OfferedSkill, robot: str, skill: str) -> None:
    """What others were asked for before, and nobody has taken."""
    names = ("ExecutionIds", "Robots", "Skills", "Arguments", "TakenBy")
    readings = await client.read([f"ns=2;s={_OFFERS}.{name}" for name in names])
    for execution_id, its_robot, its_skill, arguments, taken_by in zip(
        *[reading.value or () for reading in readings], strict=False
    ):
        if (its_robot, its_skill, taken_by) == (robot, skill, ""):
            offered.ask(execution_id, json.loads(arguments))
