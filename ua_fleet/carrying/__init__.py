"""Runs that bridges carry themselves: a plan in parts, a token that moves, and who holds it. Pure.

    split(scenario, view)                      # a plan of segments, or why it cannot be carried
    parts_of(plan, run_id, ...)                # what each bridge gets before anything begins
    holder = Holder(space, journal, facts)     # one for each bridge
    holder.take_part / take_token / take_end / segment_ended / poll      -> what the engine is to begin or to stop
    holder.to_send()                           # tokens and ends that were not acknowledged

The engine that runs a segment is that of `scenario`, as in the server.
"""

from ua_fleet.carrying.effects import AskEpoch, Begin, Carry, Gone, Pause, Send, SendEnd, SendToken, Stop, Tell
from ua_fleet.carrying.holder import Holder, RunRefused
from ua_fleet.carrying.part import Part, decode_part, encode_part, parts_of, segment_of, segment_run
from ua_fleet.carrying.plan import Plan, PlanView, Split
from ua_fleet.carrying.splitting import split
from ua_fleet.carrying.token import SegmentRound, Token, decode_token, encode_token

__all__ = [
    "AskEpoch",
    "Begin",
    "Carry",
    "Gone",
    "Holder",
    "Part",
    "Pause",
    "Plan",
    "PlanView",
    "RunRefused",
    "SegmentRound",
    "Send",
    "SendEnd",
    "SendToken",
    "Split",
    "Stop",
    "Tell",
    "Token",
    "decode_part",
    "decode_token",
    "encode_part",
    "encode_token",
    "parts_of",
    "segment_of",
    "segment_run",
    "split",
]
