"""What one bridge gets of a plan before anything begins: its own segments, and where their tokens go.

JSON, compressed with a dictionary of what stands in each part, since most parts are small. Its hash is that of the
whole plan: a token that was made for another plan is refused, and so is a second part for the same run with another
one.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any, Final

from ua_fleet.carrying.fragments import decode_step, encode_step
from ua_fleet.carrying.plan import Edge, Hearing, Plan, Segment
from ua_fleet.carrying.token import HASH_BYTES, MOST_LOOPS, MOST_RUN_ID, WHOLE, SegmentRound
from ua_fleet.errors import ScenarioError
from ua_fleet.scenario import Scenario, Value
from ua_fleet.scenario.model import End, Sequence, Task
from ua_fleet.scenario.model import Step as ScenarioStep
from ua_fleet.values import StatusCode

__all__ = [
    "MOST_PART_BYTES",
    "Part",
    "PartInvalid",
    "PartSegment",
    "Road",
    "decode_part",
    "encode_part",
    "parts_of",
    "segment_of",
    "segment_run",
]

VERSION: Final = 4
_DICTIONARY: Final = (
    b'"retries":1,"capacities":["mobile","grab"],"quantities":{"distance":[1.0,"m"]},"after":[""]},"on_unknown":"retry",'
    b'{"=":"angle"},{"key":"","line":0,"kind":"if","when":"","then":{"else":{"kind":"sequence","steps":[{"kind":"wait",'
    b'"parameters":{"limit":20.0},"segments":[{"n":1,"slots":2,"needs":[],"then":[[0,0,256,[]]],"fails":[1,255,256],'
    b'"fails":null,"steps":[]},{"n":1,"slots":1,"needs":[],"then":[],"fails":null,"steps":[{"kind":"task","key":"1",'
    b'"line":10,"name":"","skill":"","robot":"","arguments":{"to":""},"timeout_s":120.0,"on_unknown":"ask"}]},'
    b'{"version":3,"run":"20260101-000000-","scenario":"","by":"operator","hash":"","epoch":1,"lease_s":1200.0,'
    b'"adopt_after_s":300.0,"spaces":[[256,257]],"parameters":{},"segments":[{"n":0,"slots":1,"needs":[],"then":[['
)
"""Of zlib: what a part refers to in place of saying it, the frequent at its end. A change of it is a new version."""
MOST_PART_BYTES: Final = 32_000
"""As it is sent: what one message has room for beside its head and signature."""
_MOST_SPACE: Final = 0xFFFF
MOST_JSON_BYTES: Final = 1_000_000
"""Of what is in it."""
UNREADABLE: Final = (zlib.error, LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError)
"""What is raised by what others have sent where it is not what it should be."""


class PartInvalid(ScenarioError):
    """What came as a part is none, or one that this bridge cannot take."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Run the same version of ua-fleet, with the same fleet.yaml, in the server and in the bridges."


_LEAST_OF_A_ROAD: Final = 3
"""Its segment, slot and space; then what is not empty or 0."""


@dataclass(frozen=True, slots=True)
class Road:
    """Where a token goes, in which round, and which names it has for its slot."""

    segment: int
    slot: int
    space: int
    needs: tuple[str, ...] = ()
    kept: int = 0
    """Repetitions around both segments: the token says in which round of each it is."""
    entered: int = 0
    """Those that it begins, with their first round."""
    is_next: bool = False
    """Whether it begins the next round of the inmost that is kept."""

    def place(self, rounds: tuple[int, ...]) -> SegmentRound:
        """Where a token goes from a segment in these rounds."""
        there = rounds[: self.kept] + (0,) * self.entered
        return SegmentRound(self.segment, (*there[:-1], there[-1] + 1) if self.is_next else there)


@dataclass(frozen=True, slots=True)
class PartSegment:
    """A segment as its bridge has it; see `plan.Segment`."""

    number: int
    slots: int
    needs: tuple[tuple[str, ...], ...]
    then: tuple[Road, ...]
    fails: Road | None
    body: Sequence
    otherwise: tuple[Road, ...] = ()
    lost: tuple[Road, ...] = ()
    loops: tuple[int, ...] = ()
    hears: tuple[Hearing, ...] = ()
    tells: str = ""

    @property
    def roads(self) -> tuple[Road, ...]:
        """All places that a token of it may go to."""
        return (*self.then, *self.otherwise, *(() if self.fails is None else (self.fails,)), *self.lost)

    def tasks(self) -> list[Task]:
        """Its tasks, also those within other steps."""
        return [step for step in Scenario("", self.body).steps() if isinstance(step, Task)]


@dataclass(frozen=True, slots=True)
class Part:
    """What a bridge has of a run."""

    run_id: str
    scenario: str
    by: str
    plan_hash: bytes
    epoch: int
    lease_s: float
    adopt_after_s: float
    """A bridge that was away for so long asks another one whether its token was adopted; 0: it does not."""
    spaces: tuple[int, ...]
    """Of all bridges of the run: the end goes to them."""
    parameters: Mapping[str, Value]
    segments: Mapping[int, PartSegment]

    def robots(self) -> frozenset[str]:
        """The robots that its tasks name."""
        tasks = [task for segment in self.segments.values() for task in segment.tasks()]
        return frozenset([task.robot for task in tasks if task.robot is not None])

    def tells(self) -> frozenset[int]:
        """The spaces of the bridges that this one tells something: all of the run where it may end it."""
        segments = self.segments.values()
        steps = [step for segment in segments for step in Scenario("", segment.body).steps()]
        may_end = any(segment.fails is None and not segment.tells for segment in segments)
        if may_end or any(isinstance(step, End) for step in steps):
            return frozenset(self.spaces)
        return frozenset([road.space for segment in segments for road in segment.roads])


def segment_run(run_id: str, place: SegmentRound) -> str:
    """The id under which the engine of a bridge runs a segment in one round: execution ids follow from it."""
    return f"{run_id}.{place}"


def segment_of(segment_run_id: str) -> tuple[str, SegmentRound]:
    """The run, and the segment in one round, of such an id."""
    run_id, _, place = segment_run_id.rpartition(".")
    return run_id, SegmentRound.parse(place)


def parts_of(
    plan: Plan,
    run_id: str,
    scenario: str,
    parameters: Mapping[str, Value],
    by: str,
    *,
    adopt_after_s: float = 0.0,
    epoch: int = 1,
) -> dict[int, Part]:
    """The parts of all bridges, by their spaces."""
    segments: dict[int, dict[int, PartSegment]] = {space: {} for space in plan.spaces}
    for number, segment in enumerate(plan.segments):
        segments[segment.space][number] = PartSegment(
            number,
            segment.slots,
            tuple(segment.needs),
            tuple([_road(plan, segment, edge) for edge in segment.then]),
            None if segment.fails is None else _road(plan, segment, segment.fails),
            Sequence("", 0, tuple(segment.steps)),
            tuple([_road(plan, segment, edge) for edge in segment.otherwise]),
            tuple([_road(plan, segment, edge) for edge in segment.lost]),
            segment.loops,
            tuple(segment.hears),
            segment.tells,
        )

    def made(space: int, plan_hash: bytes) -> Part:
        return Part(
            run_id,
            scenario,
            by,
            plan_hash,
            epoch,
            plan.lease_s,
            adopt_after_s,
            plan.spaces,
            parameters,
            segments[space],
        )

    whole = hashlib.sha256()
    for space in plan.spaces:
        whole.update(_json(made(space, b"")))
    plan_hash = whole.digest()[:HASH_BYTES]
    return {space: made(space, plan_hash) for space in plan.spaces}


def _road(plan: Plan, source: Segment, edge: Edge) -> Road:
    target = plan.segments[edge.segment]
    pairs = enumerate(zip(source.loops, target.loops, strict=False))
    shortest = min(len(source.loops), len(target.loops))
    kept = next((count for count, (one, other) in pairs if one != other), shortest)
    needs = () if edge.slot == WHOLE else target.needs[edge.slot]
    return Road(edge.segment, edge.slot, target.space, needs, kept, len(target.loops) - kept, edge.is_next)


def _encode_road(road: Road) -> list[Any]:
    content = [road.segment, road.slot, road.space, road.needs, road.kept, road.entered, int(road.is_next)]
    while not content[-1] and len(content) > _LEAST_OF_A_ROAD:
        content.pop()  # most roads have none of it
    return content


def _encode_segment(segment: PartSegment) -> dict[str, Any]:
    content = {
        "n": segment.number,
        "slots": segment.slots,
        "needs": segment.needs,
        "then": [_encode_road(road) for road in segment.then],
        "otherwise": [_encode_road(road) for road in segment.otherwise],
        "fails": None if segment.fails is None else _encode_road(segment.fails),
        "lost": [_encode_road(road) for road in segment.lost],
        "loops": segment.loops,
        "hears": segment.hears,
        "tells": segment.tells,
        "steps": [encode_step(step) for step in segment.body.steps],
    }
    return {name: value for name, value in content.items() if value or name in ("n", "needs", "steps", "then")}


def _json(part: Part) -> bytes:
    segments = [_encode_segment(segment) for segment in part.segments.values()]
    content = {
        "version": VERSION,
        "run": part.run_id,
        "scenario": part.scenario,
        "by": part.by,
        "hash": part.plan_hash.hex(),
        "epoch": part.epoch,
        "lease_s": part.lease_s,
        "adopt_after_s": part.adopt_after_s,
        "spaces": _ranges(part.spaces),
        "parameters": dict(part.parameters),
        "segments": segments,
    }
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode()


def encode_part(part: Part) -> bytes:
    """A part as it is sent.

    Raises:
        PartInvalid: it is too large.
    """
    deflating = zlib.compressobj(9, zdict=_DICTIONARY)
    content = deflating.compress(_json(part)) + deflating.flush()
    if len(content) > MOST_PART_BYTES:
        raise PartInvalid(
            f"the part of one bridge has {len(content)} bytes, and at most {MOST_PART_BYTES} are sent; "
            "split the scenario, or run it orchestrated"
        )
    return content


def decode_part(content: bytes) -> Part:
    """The part that somebody has sent; raises PartInvalid."""
    if len(content) > MOST_PART_BYTES:
        raise PartInvalid(f"a part has at most {MOST_PART_BYTES} bytes, this one {len(content)}")
    try:
        inflating = zlib.decompressobj(zdict=_DICTIONARY)
        text = inflating.decompress(content, MOST_JSON_BYTES)
        if inflating.unconsumed_tail or not inflating.eof:
            raise PartInvalid(f"a part holds at most {MOST_JSON_BYTES} bytes")
        data: Any = json.loads(text)
        if data["version"] != VERSION:
            raise PartInvalid(f"a part of version {data['version']!r}; this program reads version {VERSION}")
        return _part(data)
    except UNREADABLE as error:
        raise PartInvalid(f"a part of a plan cannot be read: {error!r}") from error


def _part(data: Any) -> Part:
    run_id, plan_hash = str(data["run"]), bytes.fromhex(data["hash"])
    if len(plan_hash) != HASH_BYTES or not run_id.isascii() or not 0 < len(run_id) <= MOST_RUN_ID:
        raise PartInvalid("a part has a hash or a run id of another length")
    lease_s, adopt_after_s = float(data["lease_s"]), float(data["adopt_after_s"])
    if not 0 < lease_s < inf or not 0 <= adopt_after_s < inf:
        raise PartInvalid(f"a part has a lease of {lease_s} s, and a bridge asks after {adopt_after_s} s")
    segments = {int(one["n"]): _segment(one) for one in data["segments"]}
    return Part(
        run_id,
        str(data["scenario"]),
        str(data["by"]),
        plan_hash,
        int(data["epoch"]),
        lease_s,
        adopt_after_s,
        _spaces(data["spaces"]),
        dict(data["parameters"]),
        segments,
    )


def _ranges(spaces: tuple[int, ...]) -> list[list[int]]:
    """The first and last of spaces that follow each other: those of a large fleet mostly do."""
    ranges: list[list[int]] = []
    for space in spaces:
        if ranges and space == ranges[-1][1] + 1:
            ranges[-1][1] = space
        else:
            ranges.append([space, space])
    return ranges


def _spaces(ranges: Any) -> tuple[int, ...]:
    spaces: list[int] = []
    for first, last in ranges:
        if not 0 < first <= last <= _MOST_SPACE or len(spaces) > _MOST_SPACE:
            raise PartInvalid("a part names spaces that there are not")
        spaces += range(int(first), int(last) + 1)
    return tuple(spaces)


def _segment(data: Any) -> PartSegment:
    steps: list[ScenarioStep] = [decode_step(step) for step in data["steps"]]
    slots, fails = int(data["slots"]), data.get("fails")
    needs = tuple([tuple([str(name) for name in names]) for names in data["needs"]])
    loops = tuple([int(number) for number in data.get("loops", ())])
    if not 0 < slots <= WHOLE or len(needs) != slots:
        raise PartInvalid(f"a segment has {slots} slots, and the names of {len(needs)}")
    if len(loops) > MOST_LOOPS:
        raise PartInvalid(f"a segment is within {len(loops)} repetitions, and {MOST_LOOPS} are carried")
    return PartSegment(
        int(data["n"]),
        slots,
        needs,
        _decode_roads(data["then"]),
        None if fails is None else _decode_road(fails),
        Sequence("", 0, tuple(steps)),
        _decode_roads(data.get("otherwise", ())),
        _decode_roads(data.get("lost", ())),
        loops,
        tuple([Hearing(int(mailbox), int(count)) for mailbox, count in data.get("hears", ())]),
        str(data.get("tells", "")),
    )


def _decode_roads(data: Any) -> tuple[Road, ...]:
    return tuple([_decode_road(one) for one in data])


def _decode_road(data: Any) -> Road:
    given: list[Any] = list(data)
    left_out: list[Any] = [(), 0, 0, 0]
    segment, slot, space, needs, kept, entered, is_next = given + left_out[len(given) - _LEAST_OF_A_ROAD :]
    kept, entered = int(kept), int(entered)
    if not 0 <= kept + entered <= MOST_LOOPS or min(kept, entered) < 0 or (is_next and not kept):
        raise PartInvalid("a token of a part goes into repetitions that there cannot be")
    names = tuple([str(name) for name in needs])
    return Road(int(segment), int(slot), int(space), names, kept, entered, bool(is_next))
