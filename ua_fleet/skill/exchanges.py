"""The responder's side of the exchange of ActionStates: what is said to whom, and how often it is repeated.

An exchange is open from a request until the requestor's Idle. It is only a courtesy to a requestor whose answer was
lost, and is forgotten with a restart; what counts is in the journal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from ua_fleet.skill.answers import answer_fields
from ua_fleet.skill.executions import ExecutionReport
from ua_fleet.values import StatusCode
from ua_fleet.wire.actions import ActionMessage, ActionState

__all__ = ["Exchange", "Exchanges", "Respond", "answer"]

MOST_OPEN: Final = 256
"""Exchanges that are open at a time; the one that was opened first goes."""
PATIENCE_S: Final = 5.0
"""So long after its timeout a request is told that there is nothing to say yet; after that, only the end."""


@dataclass(frozen=True, slots=True)
class Respond:
    """Send a response. It may be lost: nothing depends on it."""

    message: ActionMessage
    to: object
    """What came with the request as `reply_to`."""


def answer(request: ActionMessage, state: ActionState, report: ExecutionReport | None, to: object) -> Respond:
    """The response to a request; without a report it has no fields."""
    types, values = answer_fields(report) if report is not None else ((), ())
    message = ActionMessage(
        request.publisher_id,
        request.writer_group_id,
        request.data_set_writer_id,
        request.action_target_id,
        request.request_id,
        state,
        is_request=False,
        requestor_id=request.requestor_id,
        correlation_data=request.correlation_data,
        types=types,
        values=values,
        status=StatusCode.GOOD if report is None else report.status,
        publisher_id_type=request.publisher_id_type,
    )
    return Respond(message, to)


@dataclass(slots=True)
class Exchange:
    """One request that is being answered."""

    request: ActionMessage
    reply_to: object
    wait_until: float
    """An immediate skill may take so long until something has to be said."""
    until: float
    """So long there is an answer even if it says nothing."""
    next_at: float = math.inf
    done_said: int = 0
    """Done was said so often since the last request."""


class Exchanges:
    """The open exchanges of one responder, by execution id."""

    def __init__(self, interval_s: float, most_repeats: int) -> None:
        self._interval_s, self._most_repeats = interval_s, most_repeats
        self._open: dict[bytes, Exchange] = {}

    def open(
        self, execution_id: bytes, request: ActionMessage, reply_to: object, wait_until: float, now: float
    ) -> None:
        """A request came, again perhaps, and is to be answered there."""
        known = self._open.pop(execution_id, None)
        if known is None and len(self._open) >= MOST_OPEN:
            del self._open[next(iter(self._open))]
        until = now + (request.timeout_hint_ms or 0.0) / 1000 + PATIENCE_S
        self._open[execution_id] = Exchange(request, reply_to, wait_until, until)

    def close(self, execution_id: bytes) -> None:
        """The requestor has heard what it wants to know."""
        self._open.pop(execution_id, None)

    def get(self, execution_id: bytes) -> Exchange | None:
        """The open exchange about an execution."""
        return self._open.get(execution_id)

    def said(self, execution_id: bytes, now: float, *, is_done: bool) -> None:
        """Something was said: when it is to be repeated."""
        exchange = self._open[execution_id]
        exchange.next_at = now + self._interval_s
        if not is_done:
            if now >= exchange.until:
                exchange.next_at = math.inf
            return
        exchange.done_said += 1
        if exchange.done_said > self._most_repeats:
            del self._open[execution_id]

    def take_due(self, now: float) -> list[bytes]:
        """The executions of which something is to be said again."""
        return [execution_id for execution_id, exchange in self._open.items() if exchange.next_at <= now]

    def next_deadline(self) -> float | None:
        """When `take_due` has something next, or None."""
        nearest = math.inf
        for exchange in self._open.values():
            if exchange.next_at < nearest:
                nearest = exchange.next_at
        return None if nearest == math.inf else nearest
