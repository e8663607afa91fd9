"""What the bridges of a run get after a person has said that one of them is off: another one has its segments then.

Every bridge that is left gets its part anew, with the next epoch. Then the heir, which is the last to get it, knows

    filled   the slots that the others have filled: who has a token of a segment proves that this segment is over
    facts    what was last heard of the segments that the bridge had, and what the person says of their tasks

so that it goes on with what is not over. A task that was under way, and that the person has not said is done, begins
again, on another robot where its own lived behind the bridge that is off.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from ua_fleet.carrying.part import MOST_JSON_BYTES, MOST_PART_BYTES, Part, PartInvalid, PartSegment, decode_part
from ua_fleet.carrying.plan import Plan, PlanView, missing_requestors
from ua_fleet.carrying.token import Token
from ua_fleet.scenario import Scenario, Value
from ua_fleet.scenario.facts import Fact, StepEnded, StepState, TaskAnswered, Then
from ua_fleet.scenario.model import Sequence, Task
from ua_fleet.scenario.state import RunState, TaskPhase

__all__ = [
    "Adoption",
    "FilledSlot",
    "adopted_facts",
    "decode_adoption",
    "encode_adoption",
    "filled_slots",
    "heir_of",
    "of_segment",
    "plan_without",
    "proved_over",
]

_UNDER_WAY: Final = (TaskPhase.ASSIGNED, TaskPhase.ACCEPTED, TaskPhase.HALTING, TaskPhase.ASKED, TaskPhase.LOST)


class FilledSlot(NamedTuple):
    """A token that a bridge has, without what only it needs."""

    segment: int
    slot: int
    failed: str
    values: Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class Adoption:
    """What one bridge gets."""

    part: Part
    """With the next epoch."""
    gone: int
    """The space of the bridge that is off."""
    by: str
    """The person who has said so."""
    filled: tuple[FilledSlot, ...] = ()
    results: Mapping[str, Value] = field(default_factory=dict[str, Value])
    """Of tasks, by `task.result`, as far as the server knows them."""
    facts: Mapping[int, tuple[str, ...]] = field(default_factory=dict[int, tuple[str, ...]])
    """Lines of facts of each segment that is adopted."""


def plan_without(plan: Plan, gone: int, heir: int) -> Plan:
    """The plan with the segments of one bridge at another one; their numbers stay."""
    segments = [replace(each, space=heir) if each.space == gone else each for each in plan.segments]
    return replace(plan, segments=tuple(segments))


def heir_of(plan: Plan, gone: int, view: PlanView) -> int | None:
    """The first bridge of a plan that can take the place of one: those that hand it tokens may, and it may theirs."""
    for heir in plan.spaces:
        if heir != gone and not missing_requestors(plan_without(plan, gone, heir), view.requestors):
            return heir
    return None


def of_segment(steps: Iterable[Any], fact: Fact) -> bool:
    """Whether a fact is of a step of these, or within one."""
    step: str = getattr(fact, "step", "")
    keys = {each.key for each in Scenario("", Sequence("", 0, tuple(steps))).steps()}
    return bool(step) and step.partition("@")[0] in keys


def adopted_facts(steps: Iterable[Any], facts: Iterable[Fact], done: Collection[str], at: float, by: str) -> list[Fact]:
    """What the heir of a segment takes for true: what was heard, and then what the person says of its tasks.

    Args:
        steps: of the segment.
        facts: of the run, as the server has them.
        done: tasks that a robot has done although nobody has told so, by their names or the keys of their steps.
        at: when it was said.
        by: the person.
    """
    steps = tuple(steps)
    known = [fact for fact in facts if of_segment(steps, fact)]
    state = RunState()
    for fact in known:
        state.apply(fact)
    said: list[Fact] = []
    for step, task in state.tasks.items():
        if step not in state.ended and (step in done or task.name in done):
            said.append(TaskAnswered(at, step, Then.DONE, by))
        elif step not in state.ended and task.phase in _UNDER_WAY:
            said.append(TaskAnswered(at, step, Then.RETRY, by))
    tasks = [one for one in Scenario("", Sequence("", 0, steps)).steps() if isinstance(one, Task)]
    keys = {task.key: task.key for task in tasks} | {task.name: task.key for task in tasks}
    for name in done:
        step = keys.get(name, name)
        if step.partition("@")[0] in keys and step not in state.tasks:
            said.append(StepEnded(at, step, StepState.DONE, f"{by} has said so"))
    return known + said


def filled_slots(tokens: Iterable[Token]) -> tuple[FilledSlot, ...]:
    """What a bridge that is left says of the tokens that it has."""
    return tuple([FilledSlot(one.segment, one.slot, one.failed, one.values) for one in tokens])


def proved_over(segments: Mapping[int, PartSegment], filled: Iterable[FilledSlot]) -> dict[int, str]:
    """The segments that are over, since somebody has a token of them; and why they have failed, empty where not."""
    over: dict[int, str] = {}
    for slot in filled:
        key = (slot.segment, slot.slot)
        for number, segment in segments.items():
            if slot.failed and segment.fails is not None and (segment.fails.segment, segment.fails.slot) == key:
                over.setdefault(number, slot.failed)
            elif not slot.failed and key in [(road.segment, road.slot) for road in segment.then]:
                over[number] = ""
    left = list(over)
    while left:
        number = left.pop()
        for before, segment in segments.items():
            if before not in over and number in [road.segment for road in segment.then]:
                over[before] = ""
                left.append(before)
    return over


def encode_adoption(adoption: Adoption, part: bytes) -> bytes:
    """An adoption as it is sent, with its part as it is encoded; raises PartInvalid where it is too large."""
    content = {
        "part": part.hex(),
        "gone": adoption.gone,
        "by": adoption.by,
        "filled": [[one.segment, one.slot, one.failed, dict(one.values)] for one in adoption.filled],
        "results": dict(adoption.results),
        "facts": {str(number): lines for number, lines in adoption.facts.items()},
    }
    packed = zlib.compress(json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode(), 9)
    if len(packed) > MOST_PART_BYTES:
        raise PartInvalid(f"what the heir has to know has {len(packed)} bytes, and at most {MOST_PART_BYTES} are sent")
    return packed


def decode_adoption(content: bytes) -> Adoption:
    """The adoption that the server has sent; raises PartInvalid."""
    if len(content) > MOST_PART_BYTES:
        raise PartInvalid(f"an adoption has at most {MOST_PART_BYTES} bytes, this one {len(content)}")
    try:
        inflating = zlib.decompressobj()
        text = inflating.decompress(content, MOST_JSON_BYTES)
        if inflating.unconsumed_tail or not inflating.eof:
            raise PartInvalid(f"an adoption holds at most {MOST_JSON_BYTES} bytes")
        data: Any = json.loads(text)
        return Adoption(
            decode_part(bytes.fromhex(data["part"])),
            int(data["gone"]),
            str(data["by"]),
            tuple([FilledSlot(int(one[0]), int(one[1]), str(one[2]), dict(one[3])) for one in data["filled"]]),
            dict(data["results"]),
            {int(number): tuple([str(line) for line in lines]) for number, lines in data["facts"].items()},
        )
    except (zlib.error, KeyError, TypeError, ValueError, AttributeError, RecursionError, IndexError) as error:
        raise PartInvalid(f"an adoption cannot be read: {error!r}") from error
