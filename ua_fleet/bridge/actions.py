"""Actions of a bridge, without I/O: requests go to the responder, its effects to the driver and the network.

    ActionRequest -> loop rule -> Responder (journal) -> driver.execute
    driver's facts -> Responder (journal) -> ActionResponse, SkillStatus

A bridge whose driver has no skills answers too: there is no such skill here. Its responder has nothing to remember.

What the journal cannot write has not happened: a request is not answered then and nothing is begun, so that the
requestor asks again or gives up; a driver's fact waits here and is tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Final

from ua_fleet.bridge.core import BridgeCore, Rule
from ua_fleet.bridge.driver import (
    Driver,
    Execution,
    ExecutionEnded,
    ExecutionFact,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
    Skill,
)
from ua_fleet.bridge.journals import ExecutionJournals
from ua_fleet.bridge.skill_status import StatusBoard
from ua_fleet.bridge.unrecorded import Said, Step, Unrecorded
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError, RobotBusy, RobotOffline, SkillError, SkillRejected, StorageUnavailable
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.metadata import fields_version, type_codes
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.skill import journal as skill_journal
from ua_fleet.skill.executions import (
    CONTROL_BITS,
    HALT_TARGETS,
    OPEN,
    RESUME_TARGETS,
    SUSPEND_TARGETS,
    ExecutionReport,
    ExecutionState,
    RequestorName,
    Target,
    is_halted_by,
    pack,
    unpack,
)
from ua_fleet.skill.offers import Offer
from ua_fleet.skill.responder import (
    ActionResponder,
    Execute,
    Query,
    Respond,
    ResponderEffect,
    ResponderLimits,
)
from ua_fleet.topics import LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.transport.addresses import answer_address
from ua_fleet.transport.party import Answers
from ua_fleet.values import BuiltinType, Quality, StatusCode, quality_of
from ua_fleet.wire.actions import ActionMessage, encode_action
from ua_fleet.wire.discovered import ActionTarget
from ua_fleet.wire.packed_fields import unpack_fields

__all__ = ["OWN", "Actions", "SendTo"]

SendTo = Callable[[bytes, tuple[str, int]], None]
"""Sends a plain message to one address."""

OWN: Final = ("", 0)
"""In place of an address: who carries runs in this bridge."""
RETRY_S: Final = 1.0
"""A driver's fact that could not be journaled is tried again after so long."""
_SHOWN_AFTER_START: Final = 256
"""Executions of a run before that SkillStatus is made of, of all robots together."""
_DID: Final = {HALT_TARGETS: "halted", SUSPEND_TARGETS: "suspended", RESUME_TARGETS: "resumed"}
"""What was done at the targets with these bits."""
SKILLS_PERIOD_S: Final = 1.0
"""How often a driver is asked what skills there are."""


class Actions:
    """The commands of one bridge. The owner calls `begin` after the driver's start, and `poll` in time."""

    def __init__(
        self,
        space: int,
        publisher: Publisher,
        counters: Counters,
        *,
        driver: Driver,
        journal: skill_journal.ResponderJournal,
        requestors: Iterable[int],
        must_be_verified: bool,
        core: BridgeCore,
        send: Callable[[bytes], None],
        send_to: SendTo,
        wall_ticks: Callable[[], int],
        failed: Callable[[str, BaseException | None], None],
        followed: Callable[[skill_journal.RecordedExecution, str, str], None] | None = None,
        rule: Rule = loop_verdict,
        definitions: Mapping[Topic, str] = MappingProxyType({}),
        skills_period_s: float = SKILLS_PERIOD_S,
        answers: Answers = answer_address,
        limits: ResponderLimits | None = None,
    ) -> None:
        """Connect the parts.

        Args:
            space: the space that the bridge stands in.
            publisher: announces the Actions.
            counters: where all of the bridge count.
            driver: may have no skills.
            journal: of executions; one in memory is enough without skills.
            requestors: spaces that may command this one.
            must_be_verified: whether keys are configured: unsigned requests are dropped then.
            core: publishes SkillStatus.
            send: sends a plain message to all.
            send_to: sends a plain message to one address.
            wall_ticks: the time of the wall clock.
            followed: told of each execution whose state is new, with the names of its robot and skill.
            failed: told what an operator has to know, with the exception where a mistake of the driver was the cause.
            rule: the loop rule.
            definitions: what robots are, by the topics of their SkillStatus; announced with these.
            skills_period_s: how often the driver is asked what skills there are.
            answers: finds where a response goes.
            limits: of the responder; the usual ones if left out.
        """
        self._answer_address = answers
        self._space, self._publisher, self._counters, self._driver = space, publisher, counters, driver
        self._send, self._send_to, self._wall_ticks, self._failed, self._rule = (
            send,
            send_to,
            wall_ticks,
            failed,
            rule,
        )
        self._followed = followed
        self._journals = ExecutionJournals(space, journal)
        self._responder = ActionResponder(
            space,
            self._journals,
            counters,
            allowed_spaces=(*requestors, space),  # of its own space the loop rule lets nothing in
            must_be_verified=must_be_verified,
            limits=limits or ResponderLimits(),
        )
        self._board = StatusBoard(core, definitions)
        self._changed: list[skill_journal.RecordedExecution] = []
        """What SkillStatus has not said yet: a requestor that waits is answered first."""
        self._skills: dict[Topic, Skill] = {}
        self._skills_at, self._skills_period_s = 0.0, skills_period_s
        self._waiting = Unrecorded(), Unrecorded()
        """Of what stands in the common journal, and in that of the bridge's own runs: either may fail alone."""
        self._retry_at = 0.0
        self._due: float | None = None
        self.problem = ""
        """Why executions cannot be recorded; empty while they can."""
        self.driven_by: Callable[[str], str] = lambda _robot: ""
        """Why a robot does nothing else now, since somebody drives it by hand; empty where it may."""
        self.reserved_for: Callable[[str, int | None], str] = lambda _robot, _space: ""
        """The carried run that keeps a robot from what a space asks, or people do (None); empty: none does."""
        self.answer_own: Callable[[bytes], None] = lambda _datagram: None
        """Takes the responses to `receive_own`."""
        self.rival: Callable[[float], str] = lambda _now: ""
        """Why nothing may be begun now; empty where it may. What is under way goes on, and can be stopped."""

    def begin(self, now: float) -> None:
        """Announce the skills, and ask the driver about executions of a run before."""
        self._look_at_skills(now)
        self._go_on(self._responder.recover(), self._responder.executions(), now)

    def record_own_in(self, journal: skill_journal.ResponderJournal, now: float) -> None:
        """Record in it what `receive_own` takes, and go on with what it has of a run before."""
        found = self._journals.record_own_in(journal)
        self._go_on(self._responder.learn(found), [*found], now)

    def _go_on(
        self, effects: list[ResponderEffect], executions: list[skill_journal.RecordedExecution], now: float
    ) -> None:
        for execution in executions[-_SHOWN_AFTER_START:]:
            self._board.show(execution, now, self._wall_ticks())
        self._do(effects, now)
        self._settle(now)

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take a request. Its origin, for the loop rule, is the space of its requestor."""
        message = event.message
        reply_to = event.sender
        if reply_to is not OWN:
            name = RequestorName.parse(message.requestor_id)
            if name is not None and self._rule(Side.PUBSUB, name.space, self._space, False) is not LoopVerdict.TO_SPACE:
                self._counters.drop(Drop.LOOP, 1 + len(message.others))
                return
            reply_to = None if reply_to is None else self._answer_address(message.response_address, reply_to)
        if reply_to is None:
            self._counters.drop_malformed("response_address")
            return
        effects = self._recorded(
            lambda: self._responder.receive(message, reply_to, now, self._wall_ticks(), verified=event.verified),
            now,
            is_own=event.sender is OWN,
        )
        if effects is None and (target := self._responder.halt_of(message, verified=event.verified)) is not None:
            self._halt_unrecorded(target, message.correlation_data or b"")
        self._do(effects or (), now)
        self._settle(now)

    def receive_own(self, message: ActionMessage, now: float) -> None:
        """Take a request of who carries runs in this process; `answer_own` gets what is said to it."""
        self.receive(ActionReceived(message, OWN, verified=True), now)

    def from_driver(self, fact: ExecutionFact, now: float) -> None:
        """Take what the driver tells of an execution."""
        if isinstance(fact, ExecutionProgressed):  # is not journaled, so it waits for nothing
            self._do(self._taken(fact, now), now)
        else:
            self._record(fact.execution_id, _said(fact), lambda later: self._taken(fact, later), now)
        self._settle(now)

    @property
    def unrecorded(self) -> int:
        """What waits until the journal can be written."""
        return sum(map(len, self._waiting))

    def robot_of(self, execution_id: bytes) -> str | None:
        """The robot that an execution belongs to, where it is known."""
        execution = self._responder.execution(execution_id)
        named = None if execution is None else self._board.names_of(execution.target)
        return None if named is None else named[0]

    def busy(self, robot: str, now: float) -> str:
        """Why a robot cannot be driven by hand now; empty where nothing is under way there."""
        if problem := self.rival(now):
            return problem
        if run := self.reserved_for(robot, None):
            return f"it is reserved for the run {run}, which bridges carry; abort that first, or wait for its end"
        for execution in self._responder.executions():
            named = self._board.names_of(execution.target) if execution.report.state in OPEN else None
            if named is not None and named[0] == robot:
                return f"it does `{named[1]}`; halt that first, or wait for its end"
        return ""

    def poll(self, now: float) -> None:
        """Do what is due."""
        if now >= self._skills_at:
            self._look_at_skills(now)
        if now >= self._retry_at:
            for waiting in self._waiting:
                self._take_waiting(waiting, now)
        self._do(self._responder.poll(now), now)
        self._settle(now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None. Asked for after each datagram, so it costs nothing."""
        return self._due

    def _record(self, execution_id: bytes, said: Said, step: Step, now: float) -> None:
        """Do a step that has to be recorded, now or as soon as it can be."""
        if self._responder.execution(execution_id) is None:
            return
        waiting = self._waiting[self._journals.is_own(execution_id)]
        if not waiting.add(execution_id, said, step):
            self._counters.drop(Drop.UNASKED)
        elif len(waiting) == 1 or now >= self._retry_at:
            self._take_waiting(waiting, now)

    def _take_waiting(self, waiting: Unrecorded, now: float) -> None:
        while waiting:
            key, step = waiting.first()
            try:
                effects = self._recorded(partial(step, now), now, is_own=waiting is self._waiting[True])
            except Exception:
                waiting.remove(key)  # a step that fails for a mistake of ours must not keep the others back
                raise
            if effects is None:
                return
            waiting.remove(key)
            self._do(effects, now)

    def _taken(self, fact: ExecutionFact, now: float) -> list[ResponderEffect]:
        responder, execution_id = self._responder, fact.execution_id
        if isinstance(fact, ExecutionProgressed):
            effects = responder.running(execution_id)
            if (execution := responder.execution(execution_id)) is not None:
                self._board.progressed(execution.target, fact, now, self._wall_ticks())
            return effects
        if isinstance(fact, ExecutionSuspended):
            return responder.suspended(execution_id, fact.message)
        if isinstance(fact, ExecutionResumed):
            return responder.resumed(execution_id)
        if isinstance(fact, ExecutionNotBegun):
            return responder.not_begun(execution_id, now, self._wall_ticks())
        if isinstance(fact, ExecutionForgotten):
            unknown = ExecutionReport(ExecutionState.UNKNOWN, StatusCode.UNCERTAIN, fact.message)
            return responder.ended(execution_id, unknown, now)
        return responder.ended(execution_id, self._report_of(fact), now)

    def _report_of(self, ended: ExecutionEnded) -> ExecutionReport:
        if quality_of(ended.status) is Quality.BAD:
            return ExecutionReport(ExecutionState.FAILED, ended.status, ended.message)
        if quality_of(ended.status) is Quality.UNCERTAIN and not ended.values:  # the driver says why there are none
            return ExecutionReport(ExecutionState.DONE, ended.status, ended.message)
        execution = self._responder.execution(ended.execution_id)
        skill = None if execution is None else self._skills.get(_topic_of(execution.target))
        types = () if skill is None else type_codes(skill.response)
        try:
            result = pack(types, ended.values)
        except (LocalWireError, ValueError):
            self._counters.drop(Drop.CONVERSION)
            said = "it is done; the results do not fit what was announced"
            return ExecutionReport(ExecutionState.DONE, StatusCode.UNCERTAIN, said)
        return ExecutionReport(ExecutionState.DONE, ended.status, ended.message, result)

    def _recorded(
        self, step: Callable[[], Sequence[ResponderEffect]], now: float, *, is_own: bool
    ) -> Sequence[ResponderEffect] | None:
        """The effects of a step; None where the journal could not record it, and so nothing has happened.

        Args:
            step: what is to be recorded.
            now: monotonic seconds.
            is_own: whether it is of the bridge's own runs.
        """
        try:
            effects = step()
            # Several records may share a sync, and the robot or others hear of it now.
            self._journals.settle(is_own=is_own)
        except StorageUnavailable as error:
            if not self.problem:
                self._failed(f"executions cannot be recorded, and none is begun: {error}", None)
            self.problem = str(error)
            self._retry_at = now + RETRY_S
            return None
        if effects and not self._waiting[not is_own]:  # what waits of the others has still that problem
            self.problem = ""
        return effects

    def _do(self, effects: Iterable[ResponderEffect], now: float) -> None:
        for effect in effects:
            if isinstance(effect, Respond):
                self._respond(effect)
            elif isinstance(effect, Execute):
                self._execute(effect, now)
            elif isinstance(effect, Query):
                self._query(effect.execution, now)
            else:
                self._changed.append(effect.execution)

    def _settle(self, now: float) -> None:
        """At the end of everything that was done: SkillStatus, and when there is more to do."""
        changed, self._changed = self._changed, []
        for execution in changed:
            self._board.show(execution, now, self._wall_ticks())
            if self._followed is not None and (named := self._board.names_of(execution.target)) is not None:
                self._followed(execution, *named)
        deadlines = [self._responder.next_deadline()]
        if self._driver.has_skills:
            deadlines.append(self._skills_at)
        if any(self._waiting):
            deadlines.append(self._retry_at)
        self._due = min((due for due in deadlines if due is not None), default=None)

    def _respond(self, effect: Respond) -> None:
        to: Any = effect.to
        try:
            datagram = encode_action(effect.message)
        except LocalWireError as error:
            self._failed(f"a response could not be sent: {error}", error)
            return
        if to == OWN:
            self.answer_own(datagram)
        else:
            self._send_to(datagram, to)

    def _execute(self, effect: Execute, now: float) -> None:
        execution, execution_id = effect.execution, effect.execution.execution_id
        if execution.target.action_target_id & CONTROL_BITS:
            self._control(execution, now)
            return
        try:
            if problem := self.rival(now):
                raise RobotOffline(problem)
            named = self._board.names_of(execution.target)
            if named is not None and (problem := self.driven_by(named[0])):
                raise RobotBusy(f"{named[0]} does no skill now: {problem}")
            if named is not None and (run := self.reserved_for(named[0], execution.space)):
                raise RobotBusy(f"{named[0]} is reserved for the run {run}, which bridges carry")
            self._driver.execute(_of_driver(execution, effect.arguments()))
        except SkillError as error:
            status, said = error.ua_status, str(error)
            step = partial(self._responder.refused, execution_id, status, said)
            self._record(execution_id, Said.END, step, now)
        except Exception as error:  # noqa: BLE001 - whatever it was, the robot may have been told
            self._failed("the driver failed while it began an execution", error)
            self._do(self._responder.begun(execution_id, now), now)
            self.from_driver(ExecutionForgotten(execution_id, "the driver failed while it began this"), now)
        else:
            self._do(self._responder.begun(execution_id, now), now)

    def _control(self, request: skill_journal.RecordedExecution, now: float) -> None:
        """Have a robot halt, stand or go on; what becomes of its execution is told by the driver as ever."""
        request_id, purpose = request.execution_id, request.target.action_target_id & CONTROL_BITS
        report = ExecutionReport(ExecutionState.DONE)
        try:
            self._tell_driver(purpose, self._controlled(request))
        except SkillError as error:
            status, said = error.ua_status, str(error)
            self._record(request_id, Said.END, partial(self._responder.refused, request_id, status, said), now)
            return
        except Exception as error:  # noqa: BLE001 - whatever it was, the robot may have been told
            did = _DID[purpose]
            self._failed(f"the driver failed while it {did} an execution", error)
            report = ExecutionReport(
                ExecutionState.UNKNOWN, StatusCode.UNCERTAIN, f"the driver failed while it {did} this"
            )
        self._record(request_id, Said.END, partial(self._responder.ended, request_id, report), now)

    def _halt_unrecorded(self, target: Target, request_id: bytes) -> None:
        """Have a robot stop though the disk takes no record of that; the request is repeated until it has an answer."""
        try:
            execution = self._halted_by(target, request_id)
        except SkillRejected:
            return
        try:
            self._tell_driver(HALT_TARGETS, execution)
        except Exception as error:  # noqa: BLE001 - it is told again
            self._failed("the driver failed while it halted an execution", error)

    def _halted_by(self, target: Target, request_id: bytes) -> skill_journal.RecordedExecution:
        known = self._responder.executions()
        execution = next((one for one in known if is_halted_by(one.execution_id, request_id)), None)
        return self._under_way(execution, target)

    def _controlled(self, request: skill_journal.RecordedExecution) -> skill_journal.RecordedExecution:
        """The execution that a request to halt, suspend or resume is about; SkillRejected where it is not under way."""
        if request.target.action_target_id & CONTROL_BITS == HALT_TARGETS:
            return self._halted_by(request.target, request.execution_id)
        (named,) = unpack(request.content)
        return self._under_way(self._responder.execution(named.value), request.target)

    @staticmethod
    def _under_way(
        execution: skill_journal.RecordedExecution | None, control: Target
    ) -> skill_journal.RecordedExecution:
        target = control._replace(action_target_id=control.action_target_id & ~CONTROL_BITS)
        # Another target may be for others to command.
        if execution is None or execution.target != target or execution.report.state not in OPEN:
            raise SkillRejected("that execution is not under way")
        return execution

    def _tell_driver(self, purpose: int, execution: skill_journal.RecordedExecution) -> None:
        """Tell the driver, where the execution is in a state for that; raises SkillError."""
        is_suspended = execution.report.state is ExecutionState.SUSPENDED
        if purpose == HALT_TARGETS:
            self._driver.halt(_of_driver(execution))
        elif purpose == SUSPEND_TARGETS:
            if not is_suspended:
                self._driver.suspend(_of_driver(execution))
        elif is_suspended:
            self._driver.resume(_of_driver(execution))
        else:
            raise SkillRejected("that execution is not suspended")

    def _query(self, execution: skill_journal.RecordedExecution, now: float) -> None:
        if not self._driver.has_skills:
            return  # the journal knows a time when there were skills; they may come back
        if purpose := execution.target.action_target_id & CONTROL_BITS:
            said = f"a restart came while it was {_DID[purpose]}; see what became of the execution"
            self.from_driver(ExecutionForgotten(execution.execution_id, said), now)
            return
        try:
            self._driver.query(_of_driver(execution))
        except Exception as error:  # noqa: BLE001 - one execution must not keep the others from being asked for
            self._failed("the driver failed while it was asked about an execution", error)
            self.from_driver(ExecutionForgotten(execution.execution_id, "the driver failed when it was asked"), now)

    def _look_at_skills(self, now: float) -> None:
        """Announce what is new or has changed, and retire what is gone."""
        self._skills_at = now + self._skills_period_s
        skills = {skill.topic: skill for skill in self._driver.skills()}
        if skills == self._skills:
            return
        before, self._skills = self._skills, skills
        wall_ticks = self._wall_ticks()
        for topic, skill in before.items():
            for target in skill.targets:
                for purpose in (0, *_DID):
                    self._responder.withdraw(Target(*topic, target.id | purpose))
            if topic not in skills:
                self._tell_all(self._publisher.retire_action(topic, now=now, wall_ticks=wall_ticks))
        self._board.offer(skills.values(), now, wall_ticks)
        for topic, skill in skills.items():
            self._offer(skill, before.get(topic) != skill, now, wall_ticks)

    def _offer(self, skill: Skill, is_new: bool, now: float, wall_ticks: int) -> None:
        targets = tuple([ActionTarget(target.id, target.name) for target in skill.targets])
        controls = self._controls(skill)
        for purpose, name in controls.items():
            targets += tuple([ActionTarget(one.id | purpose, f"{one.name}, {name}") for one in skill.targets])
        if is_new:
            try:
                self._tell_all(
                    self._publisher.announce_action(
                        skill.topic, skill.name, targets, skill.request, skill.response, now=now, wall_ticks=wall_ticks
                    )
                )
            except LocalWireError as error:
                self._failed(f"the skill {skill.name} cannot be offered: {error}", None)
                return
        types, limits = type_codes(skill.request), skill.limits
        spaces = None if limits.visible_to is None else frozenset((*limits.visible_to, self._space))
        for target in skill.targets:
            for purpose in controls:
                self._responder.offer(
                    Offer(
                        Target(*skill.topic, target.id | purpose),
                        () if purpose == HALT_TARGETS else (int(BuiltinType.BYTE_STRING),),
                        requests_at_once=limits.requests_at_once,
                        spaces=spaces,
                    )
                )
            self._responder.offer(
                Offer(
                    Target(*skill.topic, target.id),
                    types,
                    version=fields_version(skill.request, skill.response),
                    immediate=skill.is_immediate,
                    requests_at_once=limits.requests_at_once,
                    spaces=spaces,
                    least_interval_s=limits.least_interval_s,
                    largest_message_bytes=limits.largest_message_bytes,
                    most_requestors=limits.most_requestors,
                    problem=skill.problem,
                )
            )

    def _controls(self, skill: Skill) -> dict[int, str]:
        """What can be asked for while an execution of a skill is under way, named, by their targets' bits."""
        controls = {HALT_TARGETS: "halt"} if self._driver.can_halt else {}
        if self._driver.can_suspend and skill.can_suspend:
            controls |= {SUSPEND_TARGETS: "suspend", RESUME_TARGETS: "resume"}
        return controls

    def _tell_all(self, datagrams: Iterable[bytes]) -> None:
        for datagram in datagrams:
            self._send(datagram)


def _said(fact: ExecutionFact) -> Said:
    if isinstance(fact, ExecutionSuspended | ExecutionResumed):
        return Said.STANDING
    return Said.NOT_BEGUN if isinstance(fact, ExecutionNotBegun) else Said.END


def _topic_of(target: Target) -> Topic:
    return Topic(target.publisher_id, target.writer_group_id, target.data_set_writer_id)


def _of_driver(execution: skill_journal.RecordedExecution, arguments: tuple[Any, ...] | None = None) -> Execution:
    """An execution as the driver is told of it; without its arguments they are read from its content."""
    return Execution(
        execution.execution_id,
        _topic_of(execution.target),
        execution.target.action_target_id,
        tuple(unpack_fields(execution.content)) if arguments is None else arguments,
        execution.timeout_ms / 1000,
    )
