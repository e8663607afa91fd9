"""Actions (OPC 10000-14 6.2.11.2): requestor and responder as pure state machines.

Messages, times and what the robot's side says come in as arguments; what is to be done comes out as effects, to be
carried out in their order. What must survive a restart is in a journal before the effect that depends on it is given.

    requestor = Requestor(name, journal)
    requestor.resume(now, utc), start(id, target, ...), receive(response, now), poll(now)
        -> Send(message) | Concluded(id, outcome) | OutcomeCorrected(id, outcome)

    responder = Responder(space, journal, counters, offers=[Offer(target), ...])
    responder.recover(), receive(request, reply_to, now, utc), poll(now)
        -> Execute(execution) | Query(execution) | Respond(message, to) | ExecutionChanged(execution)
    the robot was told: begun(id, now), or refused(id, ...); its end: ended(id, report, now); see also Query

`executions.py` has the words, `requestor.py` and `responder.py` each begin with their table of states.
"""

from ua_fleet.skill.executions import (
    ExecutionReport,
    ExecutionState,
    OutcomeKind,
    RequestorName,
    RequestOutcome,
    Target,
    pack,
    unpack,
)
from ua_fleet.skill.journal import MemoryJournal, RecordedExecution, RecordedRequest, RequestorJournal, ResponderJournal
from ua_fleet.skill.offers import Offer
from ua_fleet.skill.requestor import (
    ActionRequestor,
    Concluded,
    Contradicted,
    OutcomeCorrected,
    RequestorEffect,
    RequestPace,
    Send,
)
from ua_fleet.skill.responder import (
    ActionResponder,
    Execute,
    ExecutionChanged,
    Query,
    Respond,
    ResponderEffect,
    ResponderLimits,
)

__all__ = [
    "ActionRequestor",
    "ActionResponder",
    "Concluded",
    "Contradicted",
    "Execute",
    "ExecutionChanged",
    "ExecutionReport",
    "ExecutionState",
    "MemoryJournal",
    "Offer",
    "OutcomeCorrected",
    "OutcomeKind",
    "Query",
    "RecordedExecution",
    "RecordedRequest",
    "RequestOutcome",
    "RequestPace",
    "RequestorEffect",
    "RequestorJournal",
    "RequestorName",
    "Respond",
    "ResponderEffect",
    "ResponderJournal",
    "ResponderLimits",
    "Send",
    "Target",
    "pack",
    "unpack",
]
