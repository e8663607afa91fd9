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
from collections.abc import Collection, Iterable, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import reduce
from types import MappingProxyType
from typing import Any, Final

from ua_fleet.carrying.named_rounds import NO_ROUND, depth_of, named_rounds, rounds_of
from ua_fleet.carrying.part import (
    MOST_JSON_BYTES,
    MOST_PART_BYTES,
    UNREADABLE,
    Part,
    PartInvalid,
    PartSegment,
    decode_part,
)
from ua_fleet.carrying.plan import Plan, PlanView, missing_requestors
from ua_fleet.carrying.proof import FilledSlot, proved_over
from ua_fleet.carrying.token import SegmentRound, Token
from ua_fleet.carrying.whole_repeats import InnerRounds
from ua_fleet.scenario import Scenario, Value
from ua_fleet.scenario.facts import Fact, IterationStarted, StepEnded, StepState, TaskAnswered, TaskOver, Then
from ua_fleet.scenario.model import BranchPoint, Task
from ua_fleet.scenario.model import Sequence as Steps
from ua_fleet.scenario.state import RunState, TaskPhase

__all__ = [
    "Adoption",
    "FilledSlot",
    "adopted_facts",
    "adopted_places",
    "begun_places",
    "begun_slots",
    "decode_adoption",
    "decode_filled",
    "encode_adoption",
    "encode_filled",
    "filled_slots",
    "heir_of",
    "may_be_heir",
    "needed_places",
    "plan_without",
    "plan_without_all",
    "proved_over",
    "results_heard",
    "rounds_said",
]

_UNDER_WAY: Final = (TaskPhase.ASSIGNED, TaskPhase.ACCEPTED, TaskPhase.HALTING, TaskPhase.ASKED, TaskPhase.LOST)


@dataclass(frozen=True, slots=True)
class Adoption:
    """What one bridge gets."""

    part: Part
    """With the next epoch."""
    gone: tuple[int, ...]
    """The spaces of the bridges that are off."""
    by: str
    """The person who has said so."""
    filled: tuple[FilledSlot, ...] = ()
    results: Mapping[str, Value] = field(default_factory=dict[str, Value])
    """Of tasks, by `task.result`, as far as the server knows them."""
    facts: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    """Lines of facts of each segment that is adopted, by its place as a text."""
    stand_ins: Mapping[str, Mapping[str, str]] = field(default_factory=dict[str, Mapping[str, str]])
    """Who stands in for robots, by their names and then the capacities for which."""


def plan_without(plan: Plan, gone: int, heir: int) -> Plan:
    """The plan with the segments of one bridge at another one; their numbers stay."""
    segments = [replace(each, space=heir) if each.space == gone else each for each in plan.segments]
    return replace(plan, segments=tuple(segments))


def plan_without_all(plan: Plan, gone: Iterable[int], heir: int) -> Plan:
    """The same for several bridges."""
    return reduce(lambda left, space: plan_without(left, space, heir), gone, plan)


def heir_of(plan: Plan, gone: Collection[int], view: PlanView, away: Collection[int] = ()) -> int | None:
    """The first bridge of a plan that can take the place of some: those that hand it tokens may, and it may theirs.

    Bridges that are `away` cannot.
    """
    for heir in plan.spaces:
        if heir not in gone and heir not in away and may_be_heir(plan, gone, heir, view):
            return heir
    return None


def may_be_heir(plan: Plan, gone: Iterable[int], heir: int, view: PlanView) -> bool:
    """Whether a bridge can take the place of others."""
    return not missing_requestors(plan_without_all(plan, gone, heir), view.requestors)


def _of_steps(steps: Iterable[Any], facts: Iterable[Fact]) -> list[tuple[str, Fact]]:
    """The facts of these steps, and of those within them, with the key of the step in its round."""
    keys = {each.key for each in Scenario("", Steps("", 0, tuple(steps))).steps()} - {
        ""
    }  # which each segment begins with
    told = [(getattr(fact, "step", ""), fact) for fact in facts]
    return [(step, fact) for step, fact in told if step and step.partition("@")[0] in keys]


def adopted_facts(
    steps: Iterable[Any],
    facts: Iterable[Fact],
    done: Collection[str],
    at: float,
    by: str,
    rounds: tuple[int, ...] = (),
) -> list[Fact]:
    """What the heir of a segment takes for true: what was heard, and then what the person says of its tasks.

    Args:
        steps: of the segment.
        facts: of the run, as the server has them.
        done: tasks that a robot has done although nobody has told so, by their names or the keys of their steps. Of
            one in a repetition that is within the segment the round is said, `task@41`, or it is the newest one.
        at: when it was said.
        by: the person.
        rounds: the numbers of the repetitions around the segment.
    """
    steps, scope = tuple(steps), "".join(f"@{number}" for number in rounds)
    known = [fact for step, fact in _of_steps(steps, facts) if _is_within(step, scope)]
    state = RunState()
    for fact in known:
        state.apply(fact)
    tasks = [one for one in Scenario("", Steps("", 0, steps)).steps() if isinstance(one, Task)]
    inner = InnerRounds(known, rounds)
    named = _named_steps(tasks, done, rounds, inner)
    unheard = [step for step in named if step not in state.tasks and not inner.is_past(step)]
    begun: list[Fact] = []
    for step in sorted(unheard, key=rounds_of, reverse=True):
        if not inner.is_past(step):
            begun += inner.begin(step, at)
    unheard = [step for step in unheard if not inner.is_past(step)]
    said: list[Fact] = []
    for step, task in state.tasks.items():
        if step in state.ended or inner.is_past(step):
            continue
        if step in named or task.name in done:
            said.append(TaskAnswered(at, step, Then.DONE, by))
        elif task.phase in _UNDER_WAY:
            said.append(TaskAnswered(at, step, Then.RETRY, by))
    ended = [StepEnded(at, step, StepState.DONE, f"{by} has said so") for step in unheard]
    return [*inner.needed(known, unheard), *said, *begun, *ended]


def _named_steps(
    tasks: Iterable[Task], done: Iterable[str], rounds: tuple[int, ...], inner: InnerRounds
) -> dict[str, None]:
    """The steps that a person has named, in these rounds of the repetitions around a segment: each once."""
    keys = {name: task.key for task in tasks for name in (task.name, task.key)}
    found: dict[str, None] = {}
    for name in done:
        task, at, said = name.partition("@")
        if (key := keys.get(task)) is None:
            continue
        there = named_rounds(key, said) if at else inner.newest(key, rounds)
        if there is not None and there[: len(rounds)] == rounds:
            found["@".join((key, *map(str, there)))] = None
    return found


def adopted_places(
    segment: PartSegment, facts: Sequence[Fact], done: Collection[str], at: float, by: str
) -> dict[SegmentRound, list[Fact]]:
    """The same of a segment for each round of the repetitions around it of which something is known.

    A task that the person names without its round is one of the last round.
    """
    steps, loops = segment.body.steps, len(segment.loops)
    if steps and isinstance(point := steps[-1], BranchPoint) and point.is_loop:
        return _decided_rounds(segment.number, point, facts)
    heard, told = _by_rounds(segment, facts), dict[tuple[int, ...], list[str]]()
    keys = {name: task.key for task in segment.tasks() for name in (task.name, task.key)}
    for name in done:
        task, at_sign, said = name.partition("@")
        there = named_rounds(keys[task], said) if at_sign and task in keys else None
        if there is not None and depth_of(keys[task]):
            told.setdefault(there[:loops], []).append(name)
    last = max((*heard, *told), default=(0,) * loops)
    found: dict[SegmentRound, list[Fact]] = {}
    for each in sorted({*heard, *told, last}):
        names = done if each == last else told.get(each, ())
        found[SegmentRound(segment.number, each)] = adopted_facts(steps, heard.get(each, ()), names, at, by, each)
    return found


def rounds_said(tasks: Iterable[Task], done: Iterable[str]) -> list[tuple[int, ...] | None]:
    """In which rounds a person says that some of these tasks were done; None: in none but those that were heard of."""
    keys = {name: task.key for task in tasks for name in (task.name, task.key)}
    said = [name.partition("@") for name in done]
    named = [(keys[task], rounds) for task, at, rounds in said if at and task in keys]
    known = [(rounds == NO_ROUND, named_rounds(key, rounds)) for key, rounds in named]
    return [None if is_none else rounds for is_none, rounds in known if is_none or rounds]


def begun_places(
    segments: Mapping[int, PartSegment],
    places: Mapping[SegmentRound, Sized],
    results: Mapping[str, Value] = MappingProxyType({}),
) -> list[FilledSlot]:
    """The newest of each of these segments of which something was heard, or said by a person: it was begun.

    Whose bridge is off for good may have forgotten the rounds before, however many they were: a repetition has one
    round at a time, so that all before it are over, whether or not anybody has heard of them.

    Args:
        segments: of the bridges that are off.
        places: with what is known of each.
        results: of tasks, by `task.result`: the newest that were heard. A token of another bridge may be of a round
            before.
    """
    newest: dict[int, tuple[int, ...]] = {}
    for place, known in places.items():
        if known and place.rounds >= newest.get(place.number, place.rounds):
            newest[place.number] = place.rounds
    return [
        FilledSlot(number, slot, "", {name: results[name] for name in needs if name in results}, rounds, one.loops)
        for number, rounds in newest.items()
        for one in (segments[number],)
        for slot, needs in enumerate(one.needs)
    ]


def results_heard(
    segments: Mapping[int, PartSegment], places: Mapping[SegmentRound, Sequence[Fact]], results: Mapping[str, Value]
) -> dict[str, Value]:
    """Results without those of tasks whose last round a person has named: what is known is of a round before.

    Args:
        segments: of the bridges that are off.
        places: with what was heard of each, and then what the person says.
        results: of tasks, by `task.result`, as they were heard.
    """
    said: set[str] = set()
    for slot in begun_places(segments, places):
        facts = places[SegmentRound(slot.segment, slot.rounds)]
        heard = {fact.step for fact in facts if isinstance(fact, TaskOver)}
        ended = {fact.step for fact in facts if isinstance(fact, StepEnded)}
        ended |= {fact.step for fact in facts if isinstance(fact, TaskAnswered) and fact.then is Then.DONE}
        keys = {step.partition("@")[0] for step in ended - heard}
        said |= {task.name for task in segments[slot.segment].tasks() if task.key in keys}
    return {name: value for name, value in results.items() if name.partition(".")[0] not in said}


def _by_rounds(segment: PartSegment, facts: Iterable[Fact]) -> dict[tuple[int, ...], list[Fact]]:
    """The facts of a segment, by the rounds of the repetitions around it."""
    found: dict[tuple[int, ...], list[Fact]] = {}
    for step, fact in _of_steps(segment.body.steps, facts):
        if len(there := rounds_of(step)[: len(segment.loops)]) == len(segment.loops):
            found.setdefault(there, []).append(fact)
    return found


def begun_slots(segments: Iterable[PartSegment], facts: Sequence[Fact]) -> list[FilledSlot]:
    """What facts say of the tokens of their bridge: it has begun these segments in the last of these rounds."""
    found: list[FilledSlot] = []
    for one in segments:
        steps = one.body.steps
        if steps and isinstance(point := steps[-1], BranchPoint) and point.is_loop:
            rounds = [place.rounds for place in _decided_rounds(one.number, point, facts)]
        else:
            rounds = list(_by_rounds(one, facts))
        if rounds:
            found += [FilledSlot(one.number, slot, "", {}, max(rounds), one.loops) for slot in range(one.slots)]
    return found


def needed_places(
    segments: Mapping[int, PartSegment],
    places: Mapping[SegmentRound, tuple[str, ...]],
    filled: Iterable[FilledSlot],
) -> dict[str, tuple[str, ...]]:
    """What the heir has to know of segments: not of rounds that are over, as tokens that others have prove."""
    proved = proved_over(segments, filled)
    return {
        str(place): lines for place, lines in places.items() if place not in proved.over and not proved.is_passed(place)
    }


def _decided_rounds(number: int, point: BranchPoint, facts: Sequence[Fact]) -> dict[SegmentRound, list[Fact]]:
    """What the head of a repetition has decided."""
    found: dict[SegmentRound, list[Fact]] = {}
    last: dict[tuple[int, ...], int] = {}
    for step, fact in _of_steps((point,), facts):
        rounds = rounds_of(step)
        if isinstance(fact, IterationStarted):
            last[rounds] = fact.number
            found[SegmentRound(number, (*rounds, fact.number))] = [fact]
        elif isinstance(fact, StepEnded):
            found[SegmentRound(number, (*rounds, last.get(rounds, -1) + 1))] = [fact]
    return found


def _is_within(step: str, scope: str) -> bool:
    """Whether a step, with all its numbers, is in these rounds."""
    return f"@{'@'.join(step.split('@')[1:])}@".startswith(f"{scope}@") if scope else True


def filled_slots(tokens: Iterable[Token], segments: Mapping[int, PartSegment]) -> tuple[FilledSlot, ...]:
    """What a bridge that is left says of the tokens that it has."""
    return tuple(
        [
            FilledSlot(one.segment, one.slot, one.failed, one.values, one.rounds, segments[one.segment].loops)
            for one in tokens
        ]
    )


def encode_filled(filled: Iterable[FilledSlot]) -> list[Any]:
    """The same as JSON has it."""
    return [[*one[:3], dict(one.values), one.rounds, one.loops] for one in filled]


def decode_filled(data: Any) -> tuple[FilledSlot, ...]:
    """The slots that somebody has told; raises KeyError, TypeError or ValueError."""
    return tuple(
        [
            FilledSlot(
                int(segment), int(slot), str(failed), dict(values), tuple(map(int, rounds)), tuple(map(int, loops))
            )
            for segment, slot, failed, values, rounds, loops in data
        ]
    )


def encode_adoption(adoption: Adoption, part: bytes) -> bytes:
    """An adoption as it is sent, with its part as it is encoded; raises PartInvalid where it is too large."""
    content = {
        "part": part.hex(),
        "gone": adoption.gone[0] if len(adoption.gone) == 1 else adoption.gone,
        "by": adoption.by,
        "filled": encode_filled(adoption.filled),
        "results": dict(adoption.results),
        "facts": dict(adoption.facts),
        **({"stand_ins": dict(adoption.stand_ins)} if adoption.stand_ins else {}),
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
        gone: Any = data["gone"]
        spaces: list[Any] = [gone] if isinstance(gone, int) else list(gone)
        return Adoption(
            decode_part(bytes.fromhex(data["part"])),
            tuple([int(space) for space in spaces]),
            str(data["by"]),
            decode_filled(data["filled"]),
            dict(data["results"]),
            {str(place): tuple([str(line) for line in lines]) for place, lines in data["facts"].items()},
            {
                str(one): {str(each): str(by) for each, by in named.items()}
                for one, named in data.get("stand_ins", {}).items()
            },
        )
    except UNREADABLE as error:
        raise PartInvalid(f"an adoption cannot be read: {error!r}") from error
