"""Skills that OPC UA clients do: a person, or a program that has no bridge. Without I/O; space 0 is the server's own.

    request  -> asked     some client offers the skill now; else the robot is offline
    accept   -> taken     one client, and no other, does it
    complete -> done      fail -> failed, or refused where nobody had taken it
    halt                  of what is taken: its client is told to stop, and says how it ended
    timeout               of what is asked: timed out; of what is taken: unknown, until its client says more
    the client is gone    what it had taken is unknown; what only it could have done is refused
    restart               what was asked is refused, what was taken is unknown

Each of them is in the journal before it is shown. To the rest of the server such a robot is like any other: its
SkillStatus says what becomes of executions, and it is silent while no client offers any of its skills.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from ua_fleet.errors import LocalWireError, RobotOffline, SkillRejected, StorageUnavailable
from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.operation.log import Log
from ua_fleet.operation.robots.offered_results import OfferRefused
from ua_fleet.pubsub.events import DataReceived, SourceReturned, SourceSilent, SubscriberEvent
from ua_fleet.skill.executions import (
    OPEN,
    ExecutionReport,
    ExecutionState,
    OutcomeKind,
    RequestOutcome,
    Target,
    pack,
    unpack,
)
from ua_fleet.skill.journal import RecordedExecution, RecordedRequest, ResponderJournal
from ua_fleet.skill.prepared import PreparedRequests
from ua_fleet.skill.status import SKILL_STATUS_FIELDS, ExecutionStatus, SkillStatus, result_text
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import TICKS_PER_SECOND, StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

__all__ = ["ClientOffers", "OfferedExecution"]

MOST_REMEMBERED: Final = 1000
"""Executions; the others are forgotten, the oldest first."""
_TARGET_ID: Final = 1
_REQUESTOR: Final = "0.server"
_S: Final = ExecutionState
_KINDS: Final = {
    _S.REFUSED: OutcomeKind.REFUSED,
    _S.TIMED_OUT: OutcomeKind.TIMED_OUT,
    _S.UNKNOWN: OutcomeKind.UNKNOWN,
}
_METADATA: Final = DataSetMetaData("SkillStatus", SKILL_STATUS_FIELDS, ConfigurationVersion(1, 1))


@dataclass(frozen=True, slots=True)
class OfferedExecution:
    """An execution of such a skill, as clients see it."""

    execution_id: bytes
    robot: str
    skill: SkillModel
    topic: Topic
    """Of the Action."""
    arguments: Mapping[str, Any]
    began: int
    """Ticks."""
    until: int
    """Ticks, when it is given up, as people are told."""
    deadline: int
    """The same by a clock that nobody sets."""
    report: ExecutionReport = field(default_factory=lambda: ExecutionReport(_S.RUNNING))
    taken_by: str = ""
    """The user who does it; empty while nobody does."""
    session: str = ""
    """Of that user."""
    progress: float = 0.0
    is_halted: bool = False
    """Whether its client was told to stop."""

    @property
    def is_open(self) -> bool:
        """Whether more is expected."""
        return self.report.state in OPEN

    @property
    def state(self) -> str:
        """How it stands, for people."""
        if not self.is_open:
            return self.report.state.name.lower()
        return "halt" if self.is_halted else "taken" if self.taken_by else "asked"


@dataclass(slots=True)
class _Robot:
    model: RobotModel
    status: SkillStatus = field(default_factory=SkillStatus)
    is_heard: bool = False


class ClientOffers:
    """The skills of robots of clients. A client is known by its session; times are ticks of the wall clock."""

    def __init__(
        self,
        journal: ResponderJournal,
        *,
        show: Callable[[SubscriberEvent], None],
        told: Callable[[bytes, RequestOutcome], None],
        wall_ticks: Callable[[], int],
        log: Log,
        steady_ticks: Callable[[], int] | None = None,
    ) -> None:
        """Go on where the journal ends: what was asked or taken then is over.

        Args:
            journal: of executions.
            show: takes what a robot's SkillStatus would tell on PubSub.
            told: takes the outcome of a request, after `request` has returned.
            wall_ticks: the wall clock.
            log: is told when ends cannot be recorded.
            steady_ticks: a clock that nobody sets, for what is waited for; the wall clock where there is none.

        Raises:
            StorageUnavailable: the journal cannot be used.
        """
        self._journal, self._show, self._told, self._wall_ticks, self._log = journal, show, told, wall_ticks, log
        self._steady_ticks = steady_ticks or wall_ticks
        self.changed: Callable[[OfferedExecution], None] = lambda _asked: None
        """Told of every change of an execution."""
        self._unwritten: dict[bytes, ExecutionReport] = {}
        """Ends that could not be written down; tried again."""
        self._retry_at = 0
        self._robots: dict[Topic, _Robot] = {}
        """By their SkillStatus."""
        self._skills: dict[Topic, tuple[_Robot, SkillModel]] = {}
        """By their Actions."""
        self._sessions: dict[tuple[str, str], dict[str, str]] = {}
        """Users that offer a skill, named by robot and skill, by their sessions."""
        self._asked: dict[bytes, OfferedExecution] = {}
        self._open: dict[bytes, OfferedExecution] = {}
        """Those of them that are not over; looked at after each datagram."""
        self._proposed: dict[bytes, OfferedExecution] = {}
        """Those of which the owner has the records, and has not written them down yet."""
        self._prepared = PreparedRequests[OfferedExecution]()
        self._before: dict[bytes, RecordedExecution] = {}
        """Executions of runs before."""
        self._newest = 0
        for known in journal.executions():
            execution = known
            if known.report.state in OPEN:
                report = ExecutionReport(
                    _S.REFUSED, int(StatusCode.BAD_NO_COMMUNICATION), "the server was restarted before anybody took it"
                )
                if known.report.message:
                    said = f"the server was restarted while it was {known.report.message}"
                    report = ExecutionReport(_S.UNKNOWN, int(StatusCode.UNCERTAIN), said)
                journal.reported(known.execution_id, report)
                execution = known._replace(report=report)
            self._before[known.execution_id] = execution

    # Robots.

    def follow(self, robot: RobotModel) -> None:
        """A robot is there; those of bridges are left alone."""
        if robot.skill_status is None or robot.skill_status.space != SERVER_SPACE:
            return
        known = self._robots[robot.skill_status] = _Robot(robot)
        for skill in robot.skills:
            topic = Topic(SERVER_SPACE, robot.ns, skill.id)
            self._skills[topic] = known, skill
            for execution in self._before.values():
                if execution.target[:3] == topic:
                    known.status.show(_status_of(skill, execution.execution_id, execution.report))
        self._look(known)

    def unfollow(self, robot: RobotModel) -> None:
        """A robot that does nothing is gone."""
        if robot.skill_status is not None:
            self._robots.pop(robot.skill_status, None)
        for topic in robot.actions():
            self._skills.pop(topic, None)

    # What asks for skills; see `server.skills.methods.SkillRequests`.

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        """Ask the clients that offer a skill; said again, the same request is meant.

        Raises:
            RobotOffline: no client offers it now.
            SkillRejected: as many executions as may be are under way, or the arguments do not fit.
            StorageUnavailable: it cannot be recorded, and nobody was asked.
        """
        # The server itself has taken it; how long it may last, the skill says, which is found by its topic here.
        del timeout_s, skill
        if execution_id in self._asked or execution_id in self._before:
            return
        asked, record = self._asking(topic, robot, arguments, execution_id)
        if self._prepared.is_next(execution_id):
            asked = self._prepared.take(execution_id)
        else:
            if execution_id in self._prepared:
                self._journal.forget_executions([execution_id], {})
                self._prepared.left_out([execution_id])
            self._journal.recorded(record)
        self._forget()
        self._put(asked)
        self._told(execution_id, RequestOutcome(OutcomeKind.ACCEPTED, asked.report))

    def prepare(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> RecordedExecution | None:
        """The record of a request, for an owner that writes it down with what it follows from.

        The owner calls `recorded` then, and `request` asks the clients. None where it was recorded before; raises
        RobotOffline and SkillRejected as `request` does.
        """
        del timeout_s, skill
        if any(execution_id in known for known in (self._asked, self._before, self._prepared)):
            return None
        self._proposed[execution_id], record = self._asking(topic, robot, arguments, execution_id)
        return record

    def recorded(self, records: Iterable[RecordedRequest | RecordedExecution], left_out: Iterable[bytes]) -> None:
        """These records are on the disk now, and these that were left are not any more; those of others are passed."""
        for record in records:
            if isinstance(record, RecordedExecution):
                self._prepared.add(record.execution_id, self._proposed[record.execution_id])
        self._proposed.clear()
        self._prepared.left_out(left_out)

    def leave(self, execution_id: bytes) -> None:
        """A request that was prepared is not made after all."""
        self._prepared.leave(execution_id)

    @property
    def left(self) -> tuple[bytes, ...]:
        """Requests that were recorded and left; who records the others deletes them."""
        return self._prepared.left

    def _asking(
        self, topic: Topic, robot: str, arguments: Mapping[str, Any], execution_id: bytes
    ) -> tuple[OfferedExecution, RecordedExecution]:
        """A request that clients can be asked for now, and its record; raises as `request` does."""
        known, offered = self._skill(topic)
        if not self._sessions.get((known.model.name, offered.name)):
            raise RobotOffline(f"no client offers {robot}.{offered.name} now; see: ua-fleet skill offer")
        open_ones = sum(asked.topic == topic for asked in self.open)
        if open_ones >= offered.limits.requests_at_once:
            error = SkillRejected(f"{open_ones} executions of {robot}.{offered.name} are under way")
            error.ua_status = int(StatusCode.BAD_TOO_MANY_OPERATIONS)
            raise error
        try:
            given = {argument.name: arguments[argument.name] for argument in offered.arguments}
            content = pack(tuple([argument.type for argument in offered.arguments]), tuple(given.values()))
        except KeyError as error:
            raise SkillRejected(f"{robot}.{offered.name} takes {error}, which is not given") from error
        except (LocalWireError, ValueError) as error:
            raise SkillRejected(f"{robot}.{offered.name}: {error}") from error
        now = self._wall_ticks()
        most = round(offered.timeout_s * TICKS_PER_SECOND)
        until, deadline = now + most, self._steady_ticks() + most
        asked = OfferedExecution(execution_id, known.model.name, offered, topic, given, now, until, deadline)
        target, timeout_ms = Target(*topic, _TARGET_ID), round(offered.timeout_s * 1000)
        return asked, RecordedExecution(
            execution_id, _REQUESTOR, SERVER_SPACE, target, content, now, timeout_ms, asked.report
        )

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have the client stop that does an execution; nobody has to where nobody has taken it."""
        asked = self._asked.get(execution_id)
        if asked is None or not asked.is_open:
            raise SkillRejected(f"that execution of {robot} is not under way")
        if asked.taken_by:
            self._put(replace(asked, is_halted=True))
        else:
            status = StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT
            self._end(asked, ExecutionReport(_S.REFUSED, int(status), "halted before anybody took it"))

    def suspend_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Raise SkillRejected, with Bad_NotSupported: nobody tells a client to stand, only to stop."""
        error = SkillRejected(f"{robot} is a client, and can only be halted")
        error.ua_status = StatusCode.BAD_NOT_SUPPORTED
        raise error

    def resume_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """As `suspend_execution`."""
        self.suspend_execution(topic, robot, execution_id)

    def known_outcome(self, execution_id: bytes) -> RequestOutcome:
        """What is known of a request; KeyError where it was never made."""
        asked = self._asked.get(execution_id)
        report = asked.report if asked is not None else self._before[execution_id].report
        names = tuple([result.name for result in asked.skill.results]) if asked is not None else None
        return RequestOutcome(_KINDS.get(report.state, OutcomeKind.ACCEPTED), report, names)

    # What clients say.

    @property
    def open(self) -> list[OfferedExecution]:
        """What is asked for or under way, the oldest first."""
        return list(self._open.values())

    def skill_of(self, execution_id: bytes) -> SkillModel:
        """The skill of an execution; raises OfferRefused where there is none."""
        asked = self._asked.get(execution_id)
        if asked is None:
            raise OfferRefused(f"no robot is asked for execution {execution_id.hex()}")
        return asked.skill

    def offer(self, session: str, user: str, topic: Topic) -> None:
        """A client does a skill from now on."""
        known, skill = self._skill(topic)
        self._sessions.setdefault((known.model.name, skill.name), {})[session] = user
        self._look(known)

    def withdraw(self, session: str, topic: Topic) -> None:
        """A client does a skill no longer; what it has taken it says the end of."""
        known, skill = self._skill(topic)
        name = known.model.name, skill.name
        if self._sessions.get(name, {}).pop(session, None) is None:
            raise OfferRefused(f"this session does not offer {'.'.join(name)}")
        self._left(name)

    def departed(self, session: str) -> None:
        """A client's connection or session is over."""
        for asked in self.open:
            if asked.session == session:
                said = f"the client of {asked.taken_by}, who had taken it, is gone"
                self._end_later(asked, ExecutionReport(_S.UNKNOWN, int(StatusCode.UNCERTAIN), said))
        for name, sessions in list(self._sessions.items()):
            if sessions.pop(session, None) is not None:
                self._left(name)

    def accept(self, session: str, user: str, execution_id: bytes) -> OfferedExecution:
        """A client does what is asked for; raises OfferRefused where another one does, or it is over."""
        asked = self._offered(session, execution_id)
        if not asked.is_open:
            raise OfferRefused(f"it is over: {asked.state}")
        if asked.session and asked.session != session:
            raise OfferRefused(f"{asked.taken_by} has taken it before")
        if not asked.taken_by:
            report = ExecutionReport(_S.RUNNING, message=f"taken by {user}")
            self._journal.reported(execution_id, report)
            asked = replace(asked, report=report, taken_by=user, session=session)
            self._put(asked)
        return asked

    def progressed(self, session: str, user: str, execution_id: bytes, progress: float, message: str) -> None:
        """A client says how far it is; raises OfferRefused where it has not taken it."""
        asked = self._taken(session, user, execution_id)
        if not 0 <= progress <= 1:
            raise OfferRefused(f"progress is {progress:g}; it goes from 0 to 1")
        report = asked.report._replace(message=message or asked.report.message)
        self._put(replace(asked, progress=progress, report=report))

    def complete(self, session: str, user: str, execution_id: bytes, results: Mapping[str, Any], message: str) -> None:
        """It is done. Also said of what was given up as unknown."""
        asked = self._taken(session, user, execution_id, late=True)
        types = tuple([result.type for result in asked.skill.results])
        try:
            packed = pack(types, tuple([results[result.name] for result in asked.skill.results]))
        except (LocalWireError, ValueError, KeyError) as error:
            raise OfferRefused(f"the results do not fit: {error}") from error
        self._end(asked, ExecutionReport(_S.DONE, int(StatusCode.GOOD), message, packed))

    def fail(self, session: str, user: str, execution_id: bytes, message: str) -> None:
        """It is not done and will not be; where nobody has taken it, this client refuses for all."""
        asked = self._offered(session, execution_id)
        if asked.is_open and not asked.taken_by:
            said = message or f"{user} does not do it"
            self._end(asked, ExecutionReport(_S.REFUSED, int(StatusCode.BAD_REQUEST_NOT_ALLOWED), said))
            return
        asked = self._taken(session, user, execution_id, late=True)
        status = StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT if asked.is_halted else StatusCode.BAD_UNEXPECTED_ERROR
        self._end(asked, ExecutionReport(_S.FAILED, int(status), message or f"{user} could not do it"))

    # Time.

    def poll(self) -> None:
        """Give up what has taken too long, and write down what could not be before."""
        now = self._steady_ticks()
        if self._unwritten and now >= self._retry_at:
            unwritten, self._unwritten = self._unwritten, {}
            for execution_id, report in unwritten.items():
                if self._asked[execution_id].is_open:
                    self._end_later(self._asked[execution_id], report)
        for asked in self.open:
            if now >= asked.deadline and asked.execution_id not in self._unwritten:
                within = f"within {asked.skill.timeout_s:g} s"
                report = ExecutionReport(_S.TIMED_OUT, int(StatusCode.BAD_TIMEOUT), f"nobody took it {within}")
                if asked.taken_by:
                    said = f"{asked.taken_by} did not say how it ended {within}"
                    report = ExecutionReport(_S.UNKNOWN, int(StatusCode.UNCERTAIN), said)
                self._end_later(asked, report)

    def due_in_s(self) -> float | None:
        """After how many seconds `poll` is to be called next, or None."""
        if not self._open:
            return None
        due = [asked.deadline for asked in self._open.values() if asked.execution_id not in self._unwritten]
        due += [self._retry_at] if self._unwritten else []
        return max(0.0, (min(due) - self._steady_ticks()) / TICKS_PER_SECOND) if due else None

    # Within.

    def _skill(self, topic: Topic) -> tuple[_Robot, SkillModel]:
        found = self._skills.get(topic)
        if found is None:
            raise SkillRejected(f"{topic.name} is no skill that clients do")
        return found

    def _offered(self, session: str, execution_id: bytes) -> OfferedExecution:
        self.skill_of(execution_id)
        asked = self._asked[execution_id]
        self._skill(asked.topic)  # its robot may be gone
        if session not in self._sessions.get((asked.robot, asked.skill.name), {}) and asked.session != session:
            raise OfferRefused(f"this session does not offer {asked.robot}.{asked.skill.name}")
        return asked

    def _taken(self, session: str, user: str, execution_id: bytes, *, late: bool = False) -> OfferedExecution:
        """What a client has taken; `late` also what its user had taken before its session was lost or time ran out."""
        asked = self._offered(session, execution_id)
        if asked.is_open and asked.session == session:
            return asked
        if late and asked.report.state is _S.UNKNOWN and asked.taken_by == user:
            return asked
        if asked.is_open:
            raise OfferRefused(f"{asked.taken_by} has taken it" if asked.taken_by else "accept it first")
        raise OfferRefused(f"it is over: {asked.state}")

    def _end(self, asked: OfferedExecution, report: ExecutionReport) -> None:
        self._journal.reported(asked.execution_id, report)
        progress = 1.0 if report.state is _S.DONE else asked.progress
        self._put(replace(asked, report=report, progress=progress))

    def _end_later(self, asked: OfferedExecution, report: ExecutionReport) -> None:
        """End an execution that nobody asked to end; where it cannot be written down, it is tried again."""
        if asked.execution_id in self._unwritten:
            return
        try:
            self._end(asked, report)
        except StorageUnavailable as error:
            if not self._unwritten:
                self._log.error("ends of executions by clients are not recorded", reason=str(error))
            self._unwritten[asked.execution_id] = report
            self._retry_at = self._steady_ticks() + TICKS_PER_SECOND

    def _put(self, asked: OfferedExecution) -> None:
        self._asked[asked.execution_id] = asked
        if asked.is_open:
            self._open[asked.execution_id] = asked
        else:
            self._open.pop(asked.execution_id, None)
        known, _ = self._skill(asked.topic)
        said = _status_of(asked.skill, asked.execution_id, asked.report)._replace(progress=asked.progress)
        if known.status.show(said):
            self._say(known)
        self.changed(asked)

    def _left(self, name: tuple[str, str]) -> None:
        """A skill may have nobody any more who does it."""
        if self._sessions.get(name):
            return
        self._sessions.pop(name, None)
        for asked in self.open:
            if (asked.robot, asked.skill.name) == name and not asked.taken_by:
                said = "the last client that offered it is gone"
                self._end_later(asked, ExecutionReport(_S.REFUSED, int(StatusCode.BAD_NO_COMMUNICATION), said))
        for known in self._robots.values():
            if known.model.name == name[0]:
                self._look(known)

    def _look(self, known: _Robot) -> None:
        """Say whether a robot is there."""
        topic = known.model.skill_status
        assert topic is not None
        is_heard = any(self._sessions.get((known.model.name, skill.name)) for skill in known.model.skills)
        if is_heard == known.is_heard:
            return
        known.is_heard = is_heard
        if is_heard:
            self._show(SourceReturned(topic))
            self._say(known)
        else:
            self._show(SourceSilent(topic))

    def _say(self, known: _Robot) -> None:
        topic = known.model.skill_status
        assert topic is not None
        if not known.is_heard:
            return  # it is said when the robot is back
        self._newest = max(self._newest + 1, self._wall_ticks())
        types, values = known.status.fields()
        message = DataSetMessage(topic.id, types=types, values=values, timestamp=self._newest)
        self._show(DataReceived(topic, message, _METADATA))

    def _forget(self) -> None:
        over = [*self._before, *[key for key, asked in self._asked.items() if not asked.is_open]]
        gone = over[: max(0, len(over) - MOST_REMEMBERED)]
        if gone:
            self._journal.forget_executions(gone, {})
            for execution_id in gone:
                self._before.pop(execution_id, None)
                self._asked.pop(execution_id, None)


def _status_of(skill: SkillModel, execution_id: bytes, report: ExecutionReport) -> ExecutionStatus:
    values = [variant.value for variant in unpack(report.result)]
    results = dict(zip([result.name for result in skill.results], values, strict=False))
    progress = 1.0 if report.state is _S.DONE else 0.0
    status = 0 if report.state in OPEN else report.status
    return ExecutionStatus(
        execution_id,
        skill.name,
        report.state,
        progress,
        result_text(results) if results else "",
        report.message,
        status,
    )
