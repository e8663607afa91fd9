"""10,000 random schedules: each execution is done once, refused, timed out or Unknown, and the requestor knows it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace

import pytest

from tests.unit.skill.world import LIMITS, PACE, CrashingJournal, Makers, World
from ua_fleet.skill import (
    ActionRequestor,
    ActionResponder,
    ExecutionReport,
    ExecutionState,
    OutcomeKind,
    RecordedExecution,
    RecordedRequest,
    RequestorEffect,
    RequestorName,
    RequestOutcome,
    ResponderEffect,
)
from ua_fleet.skill.executions import NEVER_BEGUN
from ua_fleet.skill.offers import OfferDecision
from ua_fleet.wire import ActionMessage

SCHEDULES = 10_000
SHARES = 4
KINDS = {
    "accepted, RUNNING",
    "accepted, DONE",
    "accepted, FAILED",
    "refused, BAD_NOT_EXECUTABLE",
    "refused, BAD_NOT_SUPPORTED",
    "refused, BAD_SERVER_TOO_BUSY",
    "refused, BAD_TOO_MANY_OPERATIONS",
    "timed_out",
    "unknown for want of an answer",
    "unknown to the responder",
    "unknown because forgotten",
    "unknown, done 0 times",
    "unknown, done 1 times",
    "corrected",
    "withdrawn, accepted",
    "withdrawn, timed_out",
    "queried",
    "requestor restarted",
    "responder restarted",
    "crash requestor between effects",
    "crash responder between effects",
    "crash responder when the robot was told",
    *(f"crash {when} {what}" for when in ("before", "after") for what in ("requested", "withdrawn", "concluded")),
    *(f"crash {when} {what}" for when in ("before", "after") for what in ("recorded", "reported", "forgotten")),
}


@pytest.mark.parametrize("share", range(SHARES))
def test_none_is_done_twice_and_the_requestor_knows(share: int) -> None:
    seen: Counter[str] = Counter()
    for seed in range(share, SCHEDULES, SHARES):
        result = World(seed, through_codec=seed % 40 < SHARES).run()
        assert not result.problems, f"seed {seed}: {result.problems}"
        seen += result.seen
    assert not {kind for kind in KINDS if not seen[kind]}, "what does not occur is not tested"
    assert seen["contradicted"] == 0


def test_two_messages_an_exchange_promise_the_same() -> None:
    makers = Makers(pace=replace(PACE, says_idle=False), limits=replace(LIMITS, most_repeats=0))
    seen: Counter[str] = Counter()
    for seed in range(SCHEDULES // SHARES):
        result = World(seed, makers=makers).run()
        assert not result.problems, f"seed {seed}: {result.problems}"
        seen += result.seen
    assert not {kind for kind in KINDS if not seen[kind]}, "what does not occur is not tested"
    assert seen["contradicted"] == 0


@pytest.mark.parametrize("set_back_s", [1.0, 3600.0])
def test_a_clock_that_is_set_back_has_nothing_done_twice(set_back_s: float) -> None:
    seen: Counter[str] = Counter()
    # Of what was refused for its issue time no mark is kept: it is remembered until no copy of it is on its way.
    makers = Makers(set_back_s=set_back_s, limits=replace(LIMITS, most_remembered=100))
    for seed in range(SCHEDULES // SHARES // 4):
        result = World(seed, makers=makers).run()
        assert not result.problems, f"seed {seed}: {result.problems}"
        seen += result.seen
    assert seen["accepted, DONE"] > 100
    assert seen["refused, BAD_INVALID_TIMESTAMP"]


class KeepsNoIntents(CrashingJournal):
    """As if the robot were told first."""

    def recorded(self, execution: RecordedExecution) -> None:
        pass

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        pass

    def forget_executions(self, execution_ids: Collection[bytes], forgotten: Mapping[int, int]) -> None:
        pass


class KeepsNoRequests(CrashingJournal):
    def requested(self, request: RecordedRequest) -> None:
        pass

    def withdrawn(self, execution_id: bytes) -> None:
        pass

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        pass


class ForgetsRefusals(ActionResponder):
    def _record(
        self, message: ActionMessage, content: bytes, name: RequestorName, now: float, utc: int
    ) -> RecordedExecution:
        execution = super()._record(message, content, name, now, utc)
        if execution.report.state in NEVER_BEGUN:
            del self._executions[execution.execution_id]
        return execution


class BeginsWhenAsked(ActionResponder):
    """Begins on a TimeoutHint of 0, and however late."""

    def _decide(self, execution: RecordedExecution, message: ActionMessage, now: float, utc: int) -> OfferDecision:
        return super()._decide(execution, message._replace(timestamp=utc, timeout_hint_ms=1e9), now, utc)


class KnowsNoRepetition(ActionResponder):
    def receive(
        self, message: ActionMessage, reply_to: object, now: float, utc: int, *, verified: bool = False
    ) -> list[ResponderEffect]:
        self._executions.pop(message.correlation_data or b"", None)
        self._under_way.discard(message.correlation_data or b"")
        return super().receive(message, reply_to, now, utc, verified=verified)


class BelievesWhatItDoesNotKnow(ActionResponder):
    """Takes a robot that cannot tell for one that was not told."""

    def ended(self, execution_id: bytes, report: ExecutionReport, now: float) -> list[ResponderEffect]:
        if report.state is ExecutionState.UNKNOWN and execution_id in self._executions:
            return self.not_begun(execution_id, now, 0)
        return super().ended(execution_id, report, now)


class SetsNoMark(ActionResponder):
    def _make_room(self) -> None:
        super()._make_room()
        self._forgotten.clear()


class TakesSilenceForNo(ActionRequestor):
    def _conclude(self, request: RecordedRequest, outcome: RequestOutcome) -> list[RequestorEffect]:
        if outcome.kind is OutcomeKind.UNKNOWN:
            outcome = replace(outcome, kind=OutcomeKind.TIMED_OUT)
        return super()._conclude(request, outcome)


class TakesSilenceForYes(ActionRequestor):
    def _conclude(self, request: RecordedRequest, outcome: RequestOutcome) -> list[RequestorEffect]:
        if outcome.kind is OutcomeKind.UNKNOWN:
            outcome = replace(outcome, kind=OutcomeKind.ACCEPTED)
        return super()._conclude(request, outcome)


class WithdrawsNothing(ActionRequestor):
    def withdraw(self, execution_id: bytes, now: float) -> list[RequestorEffect]:
        return []


@pytest.mark.parametrize(
    "makers",
    [
        Makers(journal=KeepsNoIntents),
        Makers(journal=KeepsNoRequests),
        Makers(responder=ForgetsRefusals),
        Makers(responder=BeginsWhenAsked),
        Makers(responder=KnowsNoRepetition),
        Makers(responder=BelievesWhatItDoesNotKnow),
        Makers(responder=SetsNoMark),
        Makers(requestor=TakesSilenceForNo),
        Makers(requestor=TakesSilenceForYes),
        Makers(requestor=WithdrawsNothing),
    ],
    ids=lambda makers: next(
        made.__name__
        for made in (makers.journal, makers.responder, makers.requestor)
        if "world" not in made.__module__ and "ua_fleet" not in made.__module__
    ),
)
def test_the_schedules_find_what_is_wrong(makers: Makers) -> None:
    problems = (World(seed, makers=makers).run().problems for seed in range(3000))
    assert any(problems)
