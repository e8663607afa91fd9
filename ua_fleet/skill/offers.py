"""What can be asked of a responder, by whom, and how much of it. Pure.

A limit is looked at once, when an execution is new: what was decided is recorded, and said again however often and
however fast the request is repeated. Limits are of one offer, so of one skill of one robot:

    limit                    counts                                                    refused with
    spaces                   the requestor's space                                     Bad_UserAccessDenied
    largest_message_bytes    the arguments as Variants                                 Bad_RequestTooLarge
    most_requestors          RequestorIds with an execution under way, or that had     Bad_MaxConnectionsReached
                             one accepted within REMEMBERED_S
    requests_at_once         executions under way                                      Bad_TooManyOperations
    least_interval_s         time since the last one came that was accepted; exactly   Bad_ServerTooBusy
                             the interval is enough

Of two requests of one requestor the time between their issues is enough too: it has kept the interval, and the network
has delayed the first one more than the second. After a restart the issue times of the journal tell how long ago
something was accepted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from ua_fleet.counters import Drop
from ua_fleet.skill.executions import NEVER_BEGUN, ExecutionReport, ExecutionState, Target
from ua_fleet.skill.journal import RecordedExecution
from ua_fleet.values import TICKS_PER_SECOND, StatusCode

__all__ = ["REMEMBERED_S", "ActionOffers", "Offer", "OfferDecision"]

REMEMBERED_S: Final = 60.0
"""So long after its last request, and its last execution, a requestor still counts as one."""


@dataclass(frozen=True, slots=True)
class Offer:
    """One thing that can be asked for."""

    target: Target
    types: tuple[int, ...] | None = None
    """Of the arguments; None takes any."""
    version: int | None = None
    """Major version of the announcement; a request that was made by another one is refused."""
    immediate: bool = False
    """Whether the answer waits for the end."""
    requests_at_once: int = 1
    spaces: frozenset[int] | None = None
    """Whose requests are taken, of the spaces that may command at all; None: all of them."""
    least_interval_s: float = 0.0
    largest_message_bytes: int | None = None
    """None: whatever a message holds."""
    most_requestors: int | None = None
    """None: as many as there are."""
    problem: Callable[[tuple[Any, ...]], str | None] | None = None
    """Why these arguments are not legal, or None."""


class OfferDecision(NamedTuple):
    """What is to be recorded of a new request, and what a refusal is counted as."""

    report: ExecutionReport
    drop: Drop | None = None


@dataclass(slots=True)
class _Use:
    """What was accepted of one offer; times are monotonic."""

    last_at: float = -math.inf
    last: RecordedExecution | None = None
    """What was accepted last, then."""
    requestors: dict[str, float] = field(default_factory=dict[str, float])
    """When each was accepted last."""


class ActionOffers:
    """The offers of one responder, and how they are used."""

    def __init__(self, offers: Iterable[Offer], executions: Iterable[RecordedExecution]) -> None:
        """Begin with what the journal has of a run before."""
        self._offers = {offer.target: offer for offer in offers}
        self._before = [execution for execution in executions if execution.report.state not in NEVER_BEGUN]
        self._uses: dict[Target, _Use] = {}

    def learn(self, executions: Iterable[RecordedExecution]) -> None:
        """Count these, too, where nothing has been asked for since the beginning."""
        self._before += [execution for execution in executions if execution.report.state not in NEVER_BEGUN]

    def put(self, offer: Offer) -> None:
        """Take requests for it from now on. How it was used before still counts."""
        self._offers[offer.target] = offer

    def remove(self, target: Target) -> None:
        """Refuse requests for it from now on."""
        self._offers.pop(target, None)

    def get(self, target: Target) -> Offer | None:
        """What is offered there."""
        return self._offers.get(target)

    def is_hidden(self, target: Target, space: int) -> bool:
        """Whether there is something that is not for this space."""
        offer = self._offers.get(target)
        return offer is not None and offer.spaces is not None and space not in offer.spaces

    def decide(
        self,
        execution: RecordedExecution,
        types: tuple[int, ...],
        values: tuple[Any, ...],
        under_way: Collection[RecordedExecution],
        now: float,
        utc: int,
        *,
        version: int | None = None,
    ) -> OfferDecision:
        """RUNNING where a new request of a space that may ask can begin; else why not. See `accepted`.

        Args:
            execution: as it would be recorded.
            types: of its arguments.
            values: its arguments.
            under_way: executions of all offers.
            now: monotonic seconds.
            utc: ticks.
            version: of the announcement by which the arguments were put in order, where the request says it.
        """
        offer = self._offers.get(execution.target)
        if offer is None:
            return _refused(StatusCode.BAD_NOT_SUPPORTED, "there is no such skill here", Drop.REFUSED)
        size, largest = len(execution.content), offer.largest_message_bytes
        if largest is not None and size > largest:
            said = f"the arguments have {size} bytes; the skill takes {largest}"
            return _refused(StatusCode.BAD_REQUEST_TOO_LARGE, said, Drop.TOO_LARGE)
        if None not in (version, offer.version) and version != offer.version:
            said = "the arguments were put in order for another announcement of this skill than the present one"
            return _refused(StatusCode.BAD_CONFIGURATION_ERROR, said, Drop.REFUSED)
        if offer.types is not None and types != offer.types:
            return _refused(StatusCode.BAD_TYPE_MISMATCH, "the arguments are of other types", Drop.REFUSED)
        problem = offer.problem(values) if offer.problem is not None else None
        if problem is not None:
            return _refused(StatusCode.BAD_OUT_OF_RANGE, problem, Drop.REFUSED)
        same = [other for other in under_way if other.target == offer.target]
        return self._within_limits(offer, execution, same, now, utc)

    def _within_limits(
        self, offer: Offer, execution: RecordedExecution, under_way: Collection[RecordedExecution], now: float, utc: int
    ) -> OfferDecision:
        self._recall(now, utc)
        use = self._uses.get(offer.target) or _Use()
        if offer.most_requestors is not None:
            others = {other.requestor_id for other in under_way}
            others |= {one for one, last_at in use.requestors.items() if now < last_at + REMEMBERED_S}
            others.discard(execution.requestor_id)
            if len(others) >= offer.most_requestors:
                said = f"{len(others)} others ask for this; it takes {offer.most_requestors} requestors"
                return _refused(StatusCode.BAD_MAX_CONNECTIONS_REACHED, said, Drop.TOO_MANY_REQUESTORS)
        if len(under_way) >= offer.requests_at_once:
            said = f"{len(under_way)} such executions are under way"
            return _refused(StatusCode.BAD_TOO_MANY_OPERATIONS, said, Drop.TOO_MANY)
        if now < use.last_at + offer.least_interval_s and not _has_waited(execution, use.last, offer.least_interval_s):
            said = f"asked for again within {offer.least_interval_s:g} s"
            return _refused(StatusCode.BAD_SERVER_TOO_BUSY, said, Drop.TOO_SOON)
        return OfferDecision(ExecutionReport(ExecutionState.RUNNING))

    def accepted(self, execution: RecordedExecution, now: float) -> None:
        """A new execution was recorded, and is told to the robot."""
        use = self._uses.setdefault(execution.target, _Use())
        use.last_at, use.last = now, execution
        use.requestors[execution.requestor_id] = now
        for requestor_id in [one for one, last_at in use.requestors.items() if now >= last_at + REMEMBERED_S]:
            del use.requestors[requestor_id]

    def _recall(self, now: float, utc: int) -> None:
        """Put the journal's executions onto this run's clock."""
        for execution in self._before:
            at = now - max(0, utc - execution.issued) / TICKS_PER_SECOND
            use = self._uses.setdefault(execution.target, _Use())
            if at >= use.last_at:
                use.last_at, use.last = at, execution
            use.requestors[execution.requestor_id] = max(at, use.requestors.get(execution.requestor_id, at))
        self._before.clear()


def _has_waited(execution: RecordedExecution, last: RecordedExecution | None, interval_s: float) -> bool:
    """Whether a requestor has waited so long since its last request."""
    if last is None or last.requestor_id != execution.requestor_id:
        return False
    return execution.issued - last.issued >= round(interval_s * TICKS_PER_SECOND)


def _refused(status: StatusCode, said: str, drop: Drop) -> OfferDecision:
    return OfferDecision(ExecutionReport(ExecutionState.REFUSED, status, said), drop)
