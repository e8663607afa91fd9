"""Teleoperation of one server: asks the bridges for leases, sends setpoints, and shows what the bridges say.

    Acquire, Renew, Release -> Action without a journal -> bridge;  its answer is that of the Method
    Drive                   -> checked against the lease, encoded, sent: nothing waits, and nothing is kept
    status of the bridge    -> nodes; what runs and skills know of the robot; the end of a lease

A session that ends, loses its connection or its right loses its leases at once. After a restart nothing is adopted: a
lease that a bridge still knows ends there by itself, and meanwhile its nodes show it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import Any, Final

import structlog

from ua_fleet.errors import LeaseRefused, RobotOffline, UaFleetError
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.nodes.teleoperation_nodes import STATUS_VARIABLES, drop_name, key_of
from ua_fleet.operation.leases import EndedLease, HeldLease, HeldLeases
from ua_fleet.pubsub.events import (
    ActionReceived,
    DataReceived,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SubscriberEvent,
)
from ua_fleet.server.asked_actions import AskedActions, refusal
from ua_fleet.skill.executions import OutcomeKind, RequestOutcome, named_results
from ua_fleet.teleoperation import Setpoint, State, Status, TeleoperationModel
from ua_fleet.teleoperation.messages import (
    ACQUIRE,
    RELEASE,
    RENEW,
    SETPOINT_DROPS,
    encode_setpoint,
    read_granted,
    read_status,
)
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["AcquireAnswer", "DrivingSession", "TeleoperationService"]

INSTANCE: Final = "teleoperation"
"""Second part of the RequestorId: these requests are not those of skills, and stand in no journal."""
RELEASE_S: Final = 5.0
"""So long a bridge is asked to take a lease back; after that it has ended by silence."""
MOST_REQUESTS: Final = 1000
"""That are remembered."""
_UINT32: Final = int(BuiltinType.UINT32)
_BAD: Final = 0x8000_0000
_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)
_REFUSED: Final = int(StatusCode.BAD_SECURITY_CHECKS_FAILED)
_LAST_USABLE: Final = int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)
_OF_SOURCES: Final = (DataReceived, SourceSilent, SourceStale, SourceReturned, SourceRefused)

_log: Any = structlog.get_logger("ua_fleet.server")


@dataclass(frozen=True, slots=True)
class DrivingSession:
    """A session that wants to drive."""

    session: str
    """Its key."""
    name: str
    """Of its user, which others see."""
    caller: Any
    """For the audit log."""
    gone: Callable[[], str]
    """Why it may drive no more; empty while it may."""


@dataclass(frozen=True, slots=True)
class AcquireAnswer:
    """What Acquire answers."""

    lease: int
    counter: int
    taken_from: str


class _Robot:
    """What is known of one robot."""

    def __init__(self, model: TeleoperationModel) -> None:
        self.model = model
        self.status: Status | None = None
        self.held_since: int | None = None
        """When its lease was first told of here; None without one."""
        self.is_silent = False
        """Whether its bridge was heard, and is not any more."""
        self.refused = 0
        self.shown: dict[str, tuple[Any, int]] = {}
        self.told = ""
        """What others were told of who drives it."""

    @property
    def is_heard(self) -> bool:
        """Whether its bridge says how it is; one that was never heard could not be seen to stop either."""
        return self.status is not None and not self.is_silent


class TeleoperationService:
    """See the module. The core calls `follow`, `receive`, `announced` and, in time, `poll`."""

    def __init__(
        self,
        models: Sequence[TeleoperationModel],
        *,
        send: Callable[[bytes], None],
        want: Callable[[int, int, float], bool],
        sooner: Callable[[], None],
        put: Callable[[ValueChanged], None],
        busy: Callable[[str], str],
        driven: Callable[[str, str], None],
        ended: Callable[[EndedLease, float], None],
        must_be_verified: bool,
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
    ) -> None:
        """Make a service that knows of no leases.

        Args:
            models: the robots.
            send: sends a plain message to all, now.
            want: asks for Actions until they are announced; `Subscriber.want_action`.
            sooner: called when `next_deadline` may have come nearer.
            put: has a value written to its node.
            busy: what a robot is at, in words, by its name; empty where it is at nothing.
            driven: told of who drives a robot, in words; empty: nobody.
            ended: told of each lease that is over, and how many seconds it lasted.
            must_be_verified: only signed responses are taken.
            clock: monotonic seconds.
            wall_ticks: the wall clock.
        """
        self._robots = {model.robot: _Robot(model) for model in models}
        self._by_status = {model.status: self._robots[model.robot] for model in models}
        self._actions = {(topic.space, topic.id): topic for model in models for topic in model.actions}
        self._send, self._put, self._busy = send, put, busy
        self._driven, self._ended, self._clock, self._wall_ticks = driven, ended, clock, wall_ticks
        self._codec = Codec()
        self._leases = HeldLeases()
        self._drivers: dict[HeldLease, DrivingSession] = {}
        self._requests = AskedActions(
            INSTANCE,
            send=send,
            want=want,
            sooner=sooner,
            must_be_verified=must_be_verified,
            clock=clock,
            wall_ticks=wall_ticks,
            most_remembered=MOST_REQUESTS,
            log=_log,
        )
        self.commands = self._requests.commands

    # What the core brings.

    def begin(self) -> None:
        """Ask for the Actions that are not announced yet."""
        for topic in self._actions.values():
            self.commands.want(topic)

    def follow(self, event: SubscriberEvent) -> None:
        """Take what bridges say of robots, and when nothing says it any more."""
        if not isinstance(event, _OF_SOURCES):
            return
        robot = self._by_status.get(event.topic)
        if robot is None:
            return
        if isinstance(event, DataReceived):
            self._heard(robot, event)
        elif isinstance(event, SourceReturned):
            robot.is_silent = False
            self._show(robot, 0, self._wall_ticks())
        elif isinstance(event, SourceStale):
            robot.is_silent = False
            self._show(robot, _LAST_USABLE, self._wall_ticks())
        else:
            self._lost(robot, _REFUSED if isinstance(event, SourceRefused) else _NO_COMMUNICATION)

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        self.commands.receive(event, now)

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action, where it is one of these."""
        if (announcement.publisher_id, announcement.data_set_writer_id) in self._actions:
            self.commands.announced(announcement)

    def poll(self, now: float) -> None:
        """Do what is due."""
        self.commands.poll(now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self.commands.next_deadline()

    # What people ask for.

    async def acquire(self, robot: str, driver: DrivingSession, *, take_over: bool) -> AcquireAnswer:
        """Get a robot for a session.

        Raises:
            LeaseRefused: it is at something, another one drives it, or its bridge cannot have it driven.
            RobotOffline: its bridge is not there.
        """
        known = self._robots[robot]
        model = known.model
        if at := self._busy(robot):
            said = f"{robot} cannot be driven: it is at {at}; halt that first, or wait for its end"
            raise LeaseRefused(StatusCode.BAD_INVALID_STATE, said)
        arguments = {"Holder": driver.name, "Session": driver.session, "TakeOver": take_over}
        outcome = await self._ask(known, model.acquire, ACQUIRE, arguments, unwanted=partial(self._unwanted, model))
        granted = read_granted(named_results(outcome, ()))
        if granted is None:
            raise LeaseRefused(StatusCode.BAD_CONFIGURATION_ERROR, f"the bridge of {robot} answers what is no lease")
        number, counter, axes = granted
        names = [name for name, _ in model.axes]
        # While it was asked its PubSubConnection can have been disabled, and then no end of the lease would be heard.
        unheard = "" if known.is_heard else "nothing is heard of its bridge"
        gone = driver.gone() or unheard
        if sorted(axes) != sorted(names) or gone:
            self._let_go(model, number, gone or "the server knows other axes")
        if gone:
            raise LeaseRefused(StatusCode.BAD_INVALID_STATE, f"{robot} is not given out: {gone}")
        if sorted(axes) != sorted(names):
            said = f"the bridge of {robot} knows the axes {', '.join(axes)}, and the server's fleet.yaml has others"
            raise LeaseRefused(StatusCode.BAD_CONFIGURATION_ERROR, f"{said}: {', '.join(names)}; give both the same")
        order = tuple([names.index(name) for name in axes])
        lease = HeldLease(
            robot, number, driver.session, driver.name, order, counter, self._clock(), caller=driver.caller
        )
        if (newer := self._leases.get(robot)) is not None and newer.number > number:
            raise LeaseRefused(StatusCode.BAD_RESOURCE_UNAVAILABLE, f"{newer.holder} has acquired {robot} since")
        self._over(self._leases.granted(lease))
        self._drivers[lease] = driver
        if known.status is not None:
            self._over(self._leases.heard(robot, known.status, lease.granted_at))
        self._tell_others(known)
        taken_from = named_results(outcome, ()).get("TakenFrom")
        _log.info("a lease to drive a robot by hand begins", robot=robot, lease=number, by=driver.name)
        return AcquireAnswer(number, counter, taken_from if isinstance(taken_from, str) else "")

    async def renew(self, robot: str, number: int, session: str) -> None:
        """Keep a lease. Raises LeaseRefused or RobotOffline."""
        known = self._robots[robot]
        lease = self._checked(known, number, session)
        try:
            await self._ask(known, known.model.renew, RENEW, {"Lease": number})
        except LeaseRefused as error:
            if error.ua_status == StatusCode.BAD_INVALID_STATE and self._leases.get(robot) is lease:
                self._over(self._leases.end(robot, "the bridge has ended it"))
                self._tell_others(known)
            raise

    async def release(self, robot: str, number: int, session: str) -> None:
        """Give a lease back. Raises LeaseRefused or RobotOffline; the session has it no more in any case."""
        known = self._robots[robot]
        self._checked(known, number, session)
        self._over(self._leases.end(robot, "released"))
        self._tell_others(known)
        await self._ask(known, known.model.release, RELEASE, {"Lease": number, "Reason": "released"})

    def drive(
        self, robot: str, session: str, lease_number: int, number: int, echo: int, values: Sequence[float]
    ) -> None:
        """Send a setpoint now.

        What is no setpoint is sent all the same: the bridge stops the robot for it.

        Raises:
            LeaseRefused: the session has no such lease, or it was no setpoint.
        """
        known = self._robots[robot]
        lease = self._checked(known, lease_number, session)
        setpoint = Setpoint(lease_number, number, echo, lease.ordered(values))
        self._send(encode_setpoint(self._codec, known.model.setpoints, setpoint))
        lease.setpoints += 1
        if not setpoint.values or not all(map(isfinite, setpoint.values)):
            said = f"a setpoint of {robot} has {len(lease.order)} finite numbers: it is stopped"
            raise LeaseRefused(StatusCode.BAD_INVALID_ARGUMENT, said)

    def departed(self, session: str) -> None:
        """A session has ended, or lost its connection."""
        for lease in self._leases:
            if lease.session == session:
                self._take_back(lease, "the session or its connection has ended")

    def look_after(self) -> None:
        """Take leases back from those who may drive no more."""
        for lease in self._leases:
            if gone := self._drivers[lease].gone():
                self._take_back(lease, gone)

    def close(self) -> None:
        """Give all leases back: the server ends."""
        for lease in self._leases:
            self._take_back(lease, "the server ends")

    def driven_by(self, robot: str) -> str:
        """Why a robot does nothing else now, in words; empty where nobody drives it."""
        known = self._robots.get(robot)
        return "" if known is None else known.told

    # Within.

    def _checked(self, known: _Robot, number: int, session: str) -> HeldLease:
        try:
            return self._leases.check(known.model.robot, number, session)
        except LeaseRefused:
            known.refused += 1
            key = key_of(known.model.status, "Refused")
            self._put(ValueChanged(key, _UINT32, known.refused & 0xFFFF_FFFF, 0, self._wall_ticks(), True))
            raise

    def _take_back(self, lease: HeldLease, why: str) -> None:
        known = self._robots[lease.robot]
        self._over(self._leases.end(lease.robot, why))
        self._let_go(known.model, lease.number, why)
        self._tell_others(known)

    def _let_go(self, model: TeleoperationModel, number: int, why: str) -> None:
        """Tell the bridge that nobody has a lease any more; where it is not heard, silence ends it."""
        arguments = {"Lease": number, "Reason": why}
        with contextlib.suppress(UaFleetError):
            self._requests.request(model.release, model.robot, RELEASE, arguments, RELEASE_S, lambda _outcome: None)

    def _over(self, ended: EndedLease | None) -> None:
        if ended is None:
            return
        lease = ended.lease
        del self._drivers[lease]
        _log.info("a lease to drive a robot by hand is over", robot=lease.robot, lease=lease.number, reason=ended.why)
        self._ended(ended, self._clock() - lease.granted_at)

    async def _ask(
        self,
        known: _Robot,
        topic: Topic,
        name: str,
        arguments: Mapping[str, Any],
        *,
        unwanted: Callable[[RequestOutcome], None] = lambda _outcome: None,
    ) -> RequestOutcome:
        """Ask a bridge and wait for its answer, which is `unwanted` where it comes too late."""
        model = known.model
        if not known.is_heard:
            raise RobotOffline(f"the bridge of {model.robot} is silent; check that it runs")
        try:
            outcome = await self._requests.ask(topic, model.robot, name, arguments, unwanted=unwanted)
        except TimeoutError:
            said = f"the bridge of {model.robot} does not answer; check that it runs"
            raise LeaseRefused(StatusCode.BAD_TIMEOUT, said) from None
        if (code := refusal(outcome)) is not None:
            raise LeaseRefused(code, outcome.report.message or f"the bridge of {model.robot} refuses it")
        return outcome

    def _unwanted(self, model: TeleoperationModel, outcome: RequestOutcome) -> None:
        """A lease was granted, and nobody waits for it any more."""
        granted = read_granted(named_results(outcome, ())) if outcome.kind is OutcomeKind.ACCEPTED else None
        if granted is not None:
            self._let_go(model, granted[0], "who asked for it has gone")

    def _heard(self, known: _Robot, event: DataReceived) -> None:
        message = event.message
        code, ticks = message.status or 0, message.timestamp or self._wall_ticks()
        if code & _BAD:
            self._lost(known, code)
            return
        names = [field.name for field in event.metadata.fields]
        status = read_status(dict(zip(names, message.values, strict=False)))
        if status is None:
            return
        before, robot = known.status, known.model.robot
        if before is None or status.lease != before.lease:
            known.held_since = ticks if status.lease else None
        known.status, known.is_silent = status, False
        self._over(self._leases.heard(robot, status, self._clock()))
        self._show(known, code, ticks)
        self._tell_others(known)

    def _lost(self, known: _Robot, code: int) -> None:
        known.is_silent = True
        if (lease := self._leases.get(known.model.robot)) is not None:
            self._take_back(lease, "nothing is heard of the bridge")
        self._show(known, code, self._wall_ticks())

    def _show(self, known: _Robot, code: int, ticks: int) -> None:
        status = known.status
        if status is None:
            return
        address = known.model.status
        values = {
            "State": int(status.state),
            "Holder": status.holder,
            "HeldSince": known.held_since,
            "Lease": status.lease,
            "LastNumber": status.number,
            "LastEnd": status.last_end,
            "Output": status.values,
        }
        drops = {drop_name(cause): count for cause, count in zip(SETPOINT_DROPS, status.drops, strict=True)}
        # The counter last: who sees a new one has seen what else was said with it.
        for name, value in (*values.items(), *drops.items(), ("Counter", status.counter)):
            if known.shown.get(name) != (value, code):
                known.shown[name] = value, code
                kind = STATUS_VARIABLES.get(name, _UINT32)
                is_number = kind == _UINT32 or name == "Output"
                self._put(ValueChanged(key_of(address, name), kind, value, code, ticks, is_number))

    def _tell_others(self, known: _Robot) -> None:
        """Tell runs and lists of robots who drives it."""
        robot, status = known.model.robot, known.status
        lease = self._leases.get(robot)
        holder = status.holder if status is not None and status.lease else ""
        if lease is not None:
            holder = lease.holder
        is_stopping = status is not None and status.state is not State.IDLE
        told = f"driven by hand by {holder}" if holder else "being stopped, since it was driven by hand"
        told = told if holder or is_stopping else ""
        if told != known.told:
            known.told = told
            self._driven(robot, told)
