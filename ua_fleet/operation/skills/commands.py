"""Commands to robots: skills are invoked by Actions, and each request gets one outcome, through restarts too.

    request -> requestor (journal) -> ActionRequest ‖ responder
    ActionResponse ‖ receive -> requestor (journal) -> outcome -> `told`

What the robot does after it has accepted is not waited for: it is data (SkillStatus) like any other.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any, Final

from ua_fleet.errors import SkillRejected, StorageUnavailable
from ua_fleet.operation.log import Log
from ua_fleet.operation.skills.addressing import addressed, fitting, not_announced, target_of
from ua_fleet.pubsub.action_catalog import ActionCatalog
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.skill.executions import (
    EXECUTION_ID_BYTES,
    HALT_TARGETS,
    MOST_HALTS,
    RESUME_TARGETS,
    SUSPEND_TARGETS,
    OutcomeKind,
    RequestorName,
    RequestOutcome,
    Target,
    halt_id,
)
from ua_fleet.skill.journal import RecordedExecution, RecordedRequest, RequestorJournal
from ua_fleet.skill.requestor import ActionRequestor, Contradicted, OutcomeCorrected, RequestorEffect, RequestPace, Send
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire.actions import encode_action
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["JOURNALED_PACE", "REQUESTOR_INSTANCE", "SkillCommands"]

REQUESTOR_INSTANCE: Final = "server"
"""Second part of the RequestorId. The journal's requests belong to it: it is the same in each run."""
CONTROL_TIMEOUT_S: Final = 5.0
"""A robot is not suspended or resumed later than that: things may have changed since."""
HALT_TIMEOUT_S: Final = 60.0
"""So long it is tried to halt an execution: whenever its bridge is back, what was taken back is to stop."""
MOST_REQUESTS: Final = 10_000
"""That are kept."""
MOST_REMEMBERED: Final = 1000
"""Executions of which it is known how often they were to be halted."""
_CONTROLS: Final = {HALT_TARGETS: "stop", SUSPEND_TARGETS: "suspend", RESUME_TARGETS: "resume"}
REFUSAL_WAIT_S: Final = 0.1
"""What is refused goes to another robot at once; so long another process of its bridge may say that it began it."""
JOURNALED_PACE: Final = RequestPace(refusal_wait_s=REFUSAL_WAIT_S, says_idle=False)
"""Of Actions that change nothing when they are done again, so that two messages an exchange suffice (ADR 117)."""
RETRY_S: Final = 1.0
"""After a journal that could not be written, it is tried again after so long."""

Told = Callable[[bytes, RequestOutcome], None]
"""Called with each outcome, and again where one that was Unknown is known after all."""


class SkillCommands:
    """The requestor of one process. The owner calls `resume`, `receive` and, in time, `poll`."""

    def __init__(
        self,
        journal: RequestorJournal,
        *,
        send: Callable[[bytes], None],
        want: Callable[[int, int, float], bool],
        sooner: Callable[[], None],
        wall_ticks: Callable[[], int],
        must_be_verified: bool,
        clock: Callable[[], float],
        log: Log,
        space: int = SERVER_SPACE,
        instance: str = REQUESTOR_INSTANCE,
        pace: RequestPace | None = None,
        told: Told | None = None,
        most_remembered: int = MOST_REQUESTS,
    ) -> None:
        """Make a requestor that goes on where its journal ends.

        Args:
            journal: what was requested before, and is from now on.
            send: sends a plain message to all.
            want: asks for the Actions of (space, DataSetWriterId) until they are announced; `Subscriber.want_action`.
            sooner: called when `next_deadline` may have come nearer.
            wall_ticks: the time of the wall clock.
            must_be_verified: only signed responses are taken.
            clock: monotonic seconds.
            log: is told of robots that do not do what they are asked.
            space: of this process.
            instance: of this process; with the space its RequestorId.
            pace: of repetition.
            told: learns of every outcome.
            most_remembered: requests that are kept, as of Requestor.
        """
        self.outcomes: Counter[str] = Counter()
        """Outcomes by their kind, corrections apart; `problems` are attempts that the journal could not record."""
        self._requestor = ActionRequestor(
            RequestorName.checked(space, instance),
            journal,
            pace=pace or RequestPace(refusal_wait_s=REFUSAL_WAIT_S),
            must_be_verified=must_be_verified,
            most_remembered=most_remembered,
        )
        self._journal = journal
        self._catalog = ActionCatalog()
        self._send, self._want, self._sooner, self._wall_ticks, self._told = send, want, sooner, wall_ticks, told
        self._clock, self._log = clock, log
        self._controls: dict[bytes, tuple[str, str]] = {}
        """Who is asked to stop, stand or go on, and which of these, by the id of the request."""
        self._halts: dict[bytes, int] = {}
        """The number of the last request to halt each execution."""
        self._retry_at = 0.0
        self._is_failing = False

    def resume(self, now: float, withdrawn: Collection[bytes] = ()) -> None:
        """Ask on for what was requested before a restart; these executions must not begin any more."""
        self._do(self._requestor.resume(now, self._wall_ticks(), withdrawn))

    def inquire(self, execution_id: bytes) -> None:
        """Ask once more what became of a request that nobody has answered; `told` learns of it."""
        self._do(self._requestor.inquire(execution_id, self._clock()))
        self._sooner()

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        """Have a robot do a skill, once, and wait for nothing: `told` learns of the outcome.

        Args:
            topic: (space, WriterGroupId, DataSetWriterId) of the Action.
            robot: name of the Action's target.
            skill: name of the Action.
            arguments: by their names; the bridge may have another order, or defaults for those that are not here.
            timeout_s: the robot does not begin later than that.
            execution_id: 16 bytes that were never used before; said again, the same request is meant.

        Raises:
            RobotOffline: nobody has announced the Action. It is asked for then: a later call may find it.
            SkillRejected: another skill or robot is announced there, or the arguments do not fit.
            StorageUnavailable: the request could not be recorded, and was not sent.
        """
        now, wall = self._clock(), self._wall_ticks()
        if self._requestor.is_prepared(execution_id):
            effects = self._requestor.begin(execution_id, now)
        else:
            action = self._catalog.find(topic.space, topic.id)
            if action is None:
                self._want(topic.space, topic.id, now)
                self._sooner()
                raise not_announced(topic)
            target, types, values, version = addressed(action, topic, robot, skill, arguments)
            with fitting(action):
                effects = self._requestor.start(
                    execution_id, target, types, values, timeout_s, now, wall, version=version
                )
        self._do(effects)
        self._sooner()

    def prepare(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> RecordedRequest | None:
        """The record of a request, for an owner that writes it down with what it follows from.

        The owner says `recorded` then; `request` sends it. None where it was recorded before, or nobody has announced
        the Action; raises SkillRejected as `request` does.
        """
        action = self._catalog.find(topic.space, topic.id)
        if action is None:
            return None
        target, types, values, version = addressed(action, topic, robot, skill, arguments)
        with fitting(action):
            return self._requestor.prepare(
                execution_id, target, types, values, timeout_s, self._wall_ticks(), version=version
            )

    def leave(self, execution_id: bytes) -> None:
        """A request that was prepared is not made after all."""
        self._requestor.leave(execution_id)

    @property
    def left(self) -> tuple[bytes, ...]:
        """Requests that were recorded and left; who records the others deletes them."""
        return self._requestor.left

    def recorded(self, records: Iterable[RecordedRequest | RecordedExecution], left_out: Iterable[bytes]) -> None:
        """These records are on the disk now, and these that were left are not any more; those of others are passed."""
        self._requestor.prepared(record for record in records if isinstance(record, RecordedRequest))
        self._requestor.left_out(left_out)

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot stop an execution, or not begin it any more, where it has not answered yet.

        How it ends is told as ever. Said again while the robot is asked, the same request is meant; after that another
        one is made, since it has not stopped.

        Raises:
            RobotOffline: nobody has announced the Action.
            SkillRejected: the robot has no way to stop; `ua_status` is Bad_NotSupported then.
            StorageUnavailable: the request could not be recorded, and was not sent.
        """
        with self._journal.one_sync():
            self._halt(topic, robot, execution_id)

    def _halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        self._do(self._requestor.withdraw(execution_id, self._clock()))
        number = self._halts.pop(execution_id, 0)
        while self._has_ended(halt_id(execution_id, number)):
            number = (number + 1) % MOST_HALTS
        self._halts[execution_id] = number
        if len(self._halts) > MOST_REMEMBERED:
            del self._halts[next(iter(self._halts))]
        self._control(HALT_TARGETS, topic, robot, halt_id(execution_id, number), None)

    def _has_ended(self, request_id: bytes) -> bool:
        try:
            return self._requestor.outcome(request_id) is not None
        except KeyError:
            return False

    def suspend_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot stand in the middle of an execution; that it does is told as ever. Raises as `halt` does."""
        self._control(SUSPEND_TARGETS, topic, robot, secrets.token_bytes(EXECUTION_ID_BYTES), execution_id)

    def resume_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot go on with an execution in which it stands. Raises as `halt` does."""
        self._control(RESUME_TARGETS, topic, robot, secrets.token_bytes(EXECUTION_ID_BYTES), execution_id)

    def _control(self, purpose: int, topic: Topic, robot: str, request_id: bytes, named: bytes | None) -> None:
        action = self._catalog.find(topic.space, topic.id)
        if action is None:
            raise not_announced(topic)
        target_id = target_of(action, robot) | purpose
        if target_id not in [target.action_target_id for target in action.targets]:
            error = SkillRejected(f"{robot} has no way to {_CONTROLS[purpose]} {action.request.name}")
            error.ua_status = StatusCode.BAD_NOT_SUPPORTED
            raise error
        types, values = ((), ()) if named is None else ((int(BuiltinType.BYTE_STRING),), (named,))
        now, wall, target = self._clock(), self._wall_ticks(), Target(*topic, target_id)
        timeout_s = HALT_TIMEOUT_S if purpose == HALT_TARGETS else CONTROL_TIMEOUT_S
        effects = self._requestor.start(request_id, target, types, values, timeout_s, now, wall)
        self._controls[request_id] = f"{robot}: {action.request.name}", _CONTROLS[purpose]
        self._do(effects)
        self._sooner()

    def want(self, topic: Topic) -> None:
        """See to it that an Action is announced, where it is not yet."""
        if self._catalog.find(topic.space, topic.id) is None:
            self._want(topic.space, topic.id, self._clock())
            self._sooner()

    def known_outcome(self, execution_id: bytes) -> RequestOutcome | None:
        """What is known of a request now; None while it is asked for, KeyError where it was never made."""
        outcome = self._requestor.outcome(execution_id)
        return None if outcome is None else self._named(execution_id, outcome)

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        self._try(lambda: self._requestor.receive(event.message, now, verified=event.verified), now)
        self._sooner()

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action that can be invoked."""
        self._catalog.apply(announcement)

    def action(self, topic: Topic) -> ActionMetaDataAnnouncement | None:
        """What was announced of an Action."""
        return self._catalog.find(topic.space, topic.id)

    def poll(self, now: float) -> None:
        """Do what is due: repetitions, and the end of waiting."""
        if now >= self._retry_at:
            self._try(lambda: self._requestor.poll(now), now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        due = self._requestor.next_deadline()
        return due if due is None else max(due, self._retry_at)

    def _try(self, step: Callable[[], Iterable[RequestorEffect]], now: float) -> None:
        """Do a step. What the journal cannot write has not happened, and is tried again.

        An outcome and what follows from it are synced at once.
        """
        try:
            with self._journal.one_sync():
                self._do(step())
        except StorageUnavailable as error:
            self.outcomes["problems"] += 1
            self._retry_at = now + RETRY_S
            if not self._is_failing:
                self._log.error("outcomes of commands are not recorded", reason=str(error))
            self._is_failing = True
        else:
            self._is_failing = False

    def _do(self, effects: Iterable[RequestorEffect]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                if self._is_settled():
                    self._send(encode_action(effect.message))
            elif isinstance(effect, Contradicted):
                self.outcomes["contradicted"] += 1
                self._log.error(
                    "a request was refused and accepted: two processes say that they are one bridge; end one of them",
                    space=effect.target.publisher_id,
                    execution=effect.execution_id.hex(),
                )
            elif isinstance(effect, OutcomeCorrected):
                self.outcomes["corrected"] += 1
                self._tell(effect.execution_id, effect.outcome)
            else:
                self.outcomes[effect.outcome.kind] += 1
                self._tell(effect.execution_id, effect.outcome)

    def _is_settled(self) -> bool:
        """Whether all that a message depends on is on the disk now; one that has to stay is lost, as any may be."""
        try:
            self._journal.settle()
        except StorageUnavailable:
            return False  # whoever records next says so
        return True

    def _tell(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        what, asked = self._controls.pop(execution_id, ("", ""))
        if asked and outcome.kind is not OutcomeKind.ACCEPTED:
            reason = outcome.report.message
            self._log.warning(
                "a robot did not do it", what=what, asked=asked, outcome=outcome.kind.value, reason=reason
            )
        if outcome.report.status == StatusCode.BAD_CONFIGURATION_ERROR:  # the bridge has announced something else since
            target = self._requestor.target(execution_id)
            self._want(target.publisher_id, target.data_set_writer_id, self._clock())
            self._sooner()
        if self._told is not None:
            self._told(execution_id, self._named(execution_id, outcome))

    def _named(self, execution_id: bytes, outcome: RequestOutcome) -> RequestOutcome:
        """An outcome with the names of its results, where there are some."""
        if not outcome.report.result:
            return outcome
        try:
            target = self._requestor.target(execution_id)
        except KeyError:
            return outcome
        action = self._catalog.find(target.publisher_id, target.data_set_writer_id)
        if action is None:
            return outcome
        return replace(outcome, names=tuple([field.name for field in action.response.fields]))
