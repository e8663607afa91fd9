"""What a skill takes at most, at the robot's side: the limits' edges, what counts, and what a restart leaves of it."""

from __future__ import annotations

import pytest

from ua_fleet.counters import Counters, Drop
from ua_fleet.skill import (
    ActionResponder,
    Execute,
    ExecutionReport,
    ExecutionState,
    MemoryJournal,
    Offer,
    Respond,
    Target,
)
from ua_fleet.skill.answers import read_answer
from ua_fleet.skill.offers import REMEMBERED_S
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, StatusCode
from ua_fleet.wire import ActionMessage, ActionState

S = ExecutionState
WORK, OTHER_WORK = Target(7, 3, 100, 1), Target(7, 3, 100, 2)
UTC = 10**17
ACCEPTED = ExecutionReport(S.RUNNING)


class Side:
    """A responder with one offer, and a requestor for each request."""

    def __init__(self, *offers: Offer, journal: MemoryJournal | None = None) -> None:
        self.counters = Counters()
        self.journal = journal or MemoryJournal()
        self.responder = ActionResponder(7, self.journal, self.counters, offers=offers, allowed_spaces=(0, 2, 5))
        self.responder.recover()

    def ask(
        self,
        number: int,
        now: float,
        requestor: str = "0.server",
        *,
        text: str = "",
        target: Target = WORK,
        booted_at: float = 0.0,
        delayed_s: float = 0.0,
        version: int | None = None,
    ) -> ExecutionReport:
        """What a request is answered with, once the robot was told where it is to be."""
        utc = UTC + round((booted_at + now) * TICKS_PER_SECOND)
        issued = utc - round(delayed_s * TICKS_PER_SECOND)
        execution_id = number.to_bytes(16, "big")
        known = {one.execution_id: one for one in self.journal.executions()}
        request = ActionMessage(
            *target,
            1,
            ActionState.EXECUTING,
            is_request=True,
            requestor_id=requestor,
            correlation_data=execution_id,
            timeout_hint_ms=5000.0,
            types=(BuiltinType.STRING,),
            values=(text,),
            timestamp=issued if execution_id not in known else known[execution_id].issued,
            major_version=version,
        )  # fmt: skip
        effects = self.responder.receive(request, "there", now, utc)
        if any(isinstance(effect, Execute) for effect in effects):
            effects = self.responder.begun(execution_id, now)
        (message,) = [effect.message for effect in effects if isinstance(effect, Respond)]
        return read_answer(message)

    def end(self, number: int, now: float) -> None:
        """The robot has done it."""
        self.responder.ended(number.to_bytes(16, "big"), ExecutionReport(S.DONE), now)


def refusal(report: ExecutionReport) -> int:
    assert report.state is S.REFUSED, report
    return report.status


def test_arguments_in_the_order_of_another_announcement_are_refused() -> None:
    """A bridge that came back with its arguments in another order had x for y of a request that was under way."""
    side = Side(Offer(WORK, requests_at_once=9, version=7))
    assert refusal(side.ask(1, 0.0, version=6)) == StatusCode.BAD_CONFIGURATION_ERROR
    assert side.ask(2, 0.0, version=7) == ACCEPTED
    assert side.ask(3, 0.0) == ACCEPTED, "who says none has looked himself"


def test_exactly_the_interval_is_enough() -> None:
    side = Side(Offer(WORK, requests_at_once=9, least_interval_s=0.5))
    assert side.ask(1, 10.0) == ACCEPTED
    early = side.ask(2, 10.499)
    assert (refusal(early), early.message) == (StatusCode.BAD_SERVER_TOO_BUSY, "asked for again within 0.5 s")
    assert side.ask(3, 10.5) == ACCEPTED, "what was refused does not count"
    assert refusal(side.ask(4, 10.75, "0.another")) == StatusCode.BAD_SERVER_TOO_BUSY, "whoever asks"
    assert side.counters.drops == {Drop.TOO_SOON: 2}


def test_who_keeps_the_interval_is_not_refused_because_the_network_did_not() -> None:
    side = Side(Offer(WORK, requests_at_once=9, least_interval_s=0.5))
    assert side.ask(1, 10.1, delayed_s=0.1) == ACCEPTED
    assert refusal(side.ask(2, 10.4999)) == StatusCode.BAD_SERVER_TOO_BUSY, "issued too soon"
    assert side.ask(3, 10.5) == ACCEPTED, "issued after the interval"
    assert refusal(side.ask(4, 10.99, "0.another")) == StatusCode.BAD_SERVER_TOO_BUSY, "its clock may be another"
    assert side.ask(5, 11.0, "0.another") == ACCEPTED


def test_the_interval_is_of_each_target() -> None:
    side = Side(Offer(WORK, least_interval_s=60.0), Offer(OTHER_WORK))
    assert side.ask(1, 0.0) == side.ask(2, 0.0, target=OTHER_WORK) == ACCEPTED


def test_a_repeated_request_is_held_against_no_limit() -> None:
    side = Side(Offer(WORK, least_interval_s=60.0, most_requestors=1))
    for now in (0.0, 0.1, 0.2):
        assert side.ask(1, now) == ACCEPTED
    side.end(1, 0.3)
    assert side.ask(1, 0.4).state is S.DONE
    refused = side.ask(2, 1.0)
    assert side.ask(2, 120.0) == refused, "refused is refused"
    assert side.counters.drops == {Drop.TOO_SOON: 1}, "counted once"


def test_the_largest_request() -> None:
    overhead = 5  # type and length
    side = Side(Offer(WORK, (BuiltinType.STRING,), requests_at_once=9, largest_message_bytes=100))
    assert side.ask(1, 0.0, text="x" * (100 - overhead)) == ACCEPTED
    large = side.ask(2, 0.0, text="x" * (101 - overhead))
    assert (refusal(large), large.message) == (
        StatusCode.BAD_REQUEST_TOO_LARGE,
        "the arguments have 101 bytes; the skill takes 100",
    )
    assert side.counters.drops == {Drop.TOO_LARGE: 1}


def test_a_requestor_more_than_is_taken_is_refused_until_one_is_forgotten() -> None:
    side = Side(Offer(WORK, requests_at_once=9, most_requestors=2))
    assert side.ask(1, 0.0, "0.a") == side.ask(2, 1.0, "0.b") == side.ask(3, 2.0, "0.a") == ACCEPTED
    crowd = side.ask(4, 3.0, "0.c")
    assert (refusal(crowd), crowd.message) == (
        StatusCode.BAD_MAX_CONNECTIONS_REACHED,
        "2 others ask for this; it takes 2 requestors",
    )
    for number in (1, 2, 3):
        side.end(number, 4.0)
    last_moment = 1.0 + REMEMBERED_S - 0.001
    assert refusal(side.ask(5, last_moment, "0.c")) == StatusCode.BAD_MAX_CONNECTIONS_REACHED
    assert side.ask(6, 1.0 + REMEMBERED_S, "0.c") == ACCEPTED, "b is forgotten"
    assert side.counters.drops == {Drop.TOO_MANY_REQUESTORS: 2}


def test_a_requestor_counts_while_the_robot_works_for_it() -> None:
    side = Side(Offer(WORK, requests_at_once=9, most_requestors=1))
    assert side.ask(1, 0.0, "0.a") == ACCEPTED
    assert refusal(side.ask(2, 2 * REMEMBERED_S, "0.b")) == StatusCode.BAD_MAX_CONNECTIONS_REACHED
    side.end(1, 2 * REMEMBERED_S)
    assert side.ask(3, 2 * REMEMBERED_S, "0.b") == ACCEPTED


def test_only_spaces_that_may_see_it() -> None:
    side = Side(Offer(WORK, spaces=frozenset({0, 5})))
    hidden = side.ask(1, 0.0, "2.bridge")
    assert (refusal(hidden), hidden.message) == (StatusCode.BAD_USER_ACCESS_DENIED, "this skill is not for space 2")
    assert side.ask(2, 0.0, "5.bridge") == ACCEPTED
    assert side.counters.drops == {Drop.REQUESTOR: 1}


def test_too_many_and_other_refusals_are_counted() -> None:
    side = Side(Offer(WORK, (BuiltinType.STRING,)), Offer(OTHER_WORK, (BuiltinType.INT32,)))
    assert side.ask(1, 0.0) == ACCEPTED
    assert refusal(side.ask(2, 0.0)) == StatusCode.BAD_TOO_MANY_OPERATIONS
    assert refusal(side.ask(3, 0.0, target=OTHER_WORK)) == StatusCode.BAD_TYPE_MISMATCH
    assert refusal(side.ask(4, 0.0, target=WORK._replace(action_target_id=3))) == StatusCode.BAD_NOT_SUPPORTED
    assert side.counters.drops == {Drop.TOO_MANY: 1, Drop.REFUSED: 2}


@pytest.mark.parametrize(("ago_s", "status"), [(29.9, StatusCode.BAD_SERVER_TOO_BUSY), (30.0, StatusCode.GOOD)])
def test_an_interval_goes_on_through_a_restart(ago_s: float, status: StatusCode) -> None:
    offer = Offer(WORK, least_interval_s=30.0)
    before = Side(offer)
    before.ask(1, 1000.0)
    before.end(1, 1000.0)
    assert refusal(before.ask(2, 1001.0)) == StatusCode.BAD_SERVER_TOO_BUSY
    after = Side(offer, journal=before.journal)
    booted_at = 1000.0 + ago_s  # where the monotonic clock begins anew
    assert after.ask(3, 0.0, booted_at=booted_at).status == status


@pytest.mark.parametrize(("ago_s", "is_taken"), [(REMEMBERED_S - 1, False), (REMEMBERED_S, True)])
def test_requestors_are_remembered_through_a_restart(ago_s: float, is_taken: bool) -> None:
    offer = Offer(WORK, requests_at_once=9, most_requestors=1)
    before = Side(offer)
    before.ask(1, 0.0, "0.a")
    before.end(1, 0.0)
    after = Side(offer, journal=before.journal)
    assert (after.ask(2, 0.0, "0.b", booted_at=ago_s) == ACCEPTED) is is_taken


def test_an_offer_that_is_made_anew_keeps_its_interval() -> None:
    side = Side(Offer(WORK, requests_at_once=9, least_interval_s=10.0))
    side.ask(1, 0.0)
    side.responder.withdraw(WORK)
    side.responder.offer(Offer(WORK, requests_at_once=9, least_interval_s=5.0))
    assert refusal(side.ask(2, 4.9)) == StatusCode.BAD_SERVER_TOO_BUSY
    assert side.ask(3, 5.0) == ACCEPTED
