"""Scenarios as plans of segments: which bridge does what, where tokens go, and why a scenario cannot be carried."""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import replace
from typing import Any

import pytest

from ua_fleet.carrying import PlanView, decode_part, encode_part, parts_of, split
from ua_fleet.carrying.adoption import Adoption, FilledSlot, decode_adoption, encode_adoption
from ua_fleet.carrying.fragments import FragmentInvalid, decode_step, encode_step
from ua_fleet.carrying.part import _DICTIONARY, PartInvalid, Road, _json  # pyright: ignore[reportPrivateUsage]
from ua_fleet.carrying.plan import Edge, Hearing, MailSlot, Plan
from ua_fleet.carrying.segment_scenario import decode_scenario, segment_scenario
from ua_fleet.carrying.token import WHOLE, SegmentRound
from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.scenario import FleetView, RobotView, scenario_of
from ua_fleet.scenario.model import BranchPoint, Task
from ua_fleet.values import BuiltinType

WORK = SkillModel(
    1,
    "work",
    (),
    (ArgumentModel("x", int(BuiltinType.DOUBLE), default=0.0),),
    (ArgumentModel("out", int(BuiltinType.DOUBLE)), ArgumentModel("said", int(BuiltinType.STRING))),
)
ROBOTS = {"a": 300, "b": 301, "c": 302}
ALL = frozenset({0, 300, 301, 302})
VIEW = PlanView(
    FleetView({name: RobotView(name, frozenset({name.upper()}), {"work": WORK}) for name in ROBOTS}),
    ROBOTS,
    dict.fromkeys(ROBOTS.values(), ALL),
    frozenset({"a.order"}),
)


def task(name: str, robot: str, **more: Any) -> dict[str, Any]:
    return {"task": name, "skill": "work", "robot": robot, **more}


def made(*steps: dict[str, Any], **head: Any) -> Any:
    return scenario_of(json.dumps({"version": 1, "name": "made", "steps": list(steps), **head}))


def plan(*steps: dict[str, Any], **head: Any) -> Plan:
    found, problems = split(made(*steps, **head), VIEW)
    assert found is not None, problems
    return found


def problems(*steps: dict[str, Any], view: PlanView = VIEW) -> str:
    return "\n".join(map(str, split(made(*steps), view).problems))


def test_tasks_of_one_bridge_are_one_segment() -> None:
    found = plan(task("one", "a"), task("two", "a"), task("three", "b"), task("four", "a"))
    assert [(segment.space, len(segment.steps)) for segment in found.segments] == [(300, 2), (301, 1), (300, 1)]
    assert [segment.then for segment in found.segments] == [[Edge(1, 0)], [Edge(2, 0)], []]
    assert [segment.fails for segment in found.segments] == [Edge(2, WHOLE), Edge(2, WHOLE), None]
    assert found.last == 2


def test_a_fork_has_one_join_with_a_slot_for_each_branch() -> None:
    branches = {"parallel": [[task("b1", "b")], [task("c1", "c"), task("a1", "a")]]}
    found = plan(task("first", "a"), branches, task("last", "a"))
    join = found.segments[1]
    assert (join.space, join.slots, len(join.steps)) == (300, 2, 1)
    assert found.segments[0].then == [Edge(2, 0), Edge(3, 0)]
    assert found.segments[2].then == [Edge(1, 0)]
    assert found.segments[2].fails == Edge(1, 0)
    assert found.segments[3].fails == Edge(1, 1)
    assert found.segments[4].then == [Edge(1, 1)]
    assert found.last == 1


def test_what_is_parallel_at_one_bridge_stays_with_its_engine() -> None:
    found = plan({"parallel": [[task("one", "a")], [task("two", "a")]]})
    assert len(found.segments) == 1


def test_a_token_holds_what_is_read_from_there_on_and_nothing_else() -> None:
    found = plan(
        task("one", "a"),
        task("two", "b", arguments={"x": "=one.out"}),
        task("three", "c"),
        task("four", "b", arguments={"x": "=one.out + two.out"}),
        task("five", "a"),
    )
    assert [segment.needs for segment in found.segments] == [
        [()],
        [("one.out",)],
        [("one.out", "two.out")],
        [("one.out", "two.out")],
        [()],
    ]


def test_a_join_has_the_results_of_each_branch_from_that_branch() -> None:
    reading = task("last", "a", arguments={"x": "=first.out + b1.out + c1.out"})
    found = plan(task("first", "a"), {"parallel": [[task("b1", "b")], [task("c1", "c")]]}, reading)
    join = next(segment for segment in found.segments if segment.slots == 2)
    assert join.needs == [("b1.out", "first.out"), ("c1.out",)]
    assert [one.needs for one in found.segments if one.space != 300] == [[("first.out",)], [()]]


def test_the_bridge_that_has_the_token_decides_an_if_of_several_bridges() -> None:
    branches = {"if": "c.level > 3", "then": [task("b1", "b")], "else": [task("c1", "c")]}
    found = plan(task("first", "a"), branches, task("last", "b"))
    first, then, other, last = found.segments
    assert [first.space, then.space, other.space, last.space] == [300, 301, 302, 301]
    assert (first.then, first.otherwise) == ([Edge(1, 0)], [Edge(2, 0)])
    assert then.then == other.then == [Edge(3, 0)]
    assert isinstance(first.steps[-1], BranchPoint)


def test_what_is_repeated_over_bridges_has_a_head_that_begins_each_round() -> None:
    found = plan(task("first", "a"), {"repeat": [task("b1", "b"), task("c1", "c")], "times": 3}, task("last", "a"))
    first, head, body, end, _ = found.segments
    assert [one.loops for one in found.segments] == [(), (1,), (1,), (1,), ()]
    assert (head.space, head.then, head.otherwise) == (301, [Edge(2, 0)], [Edge(4, 0)])
    assert (first.then, body.then, end.then) == ([Edge(1, 0)], [Edge(3, 0)], [Edge(1, 0, is_next=True)])
    roads = {
        one.number: one for part in parts_of(found, "run", "made", {}, "x").values() for one in part.segments.values()
    }
    assert [roads[0].then[0].place(()), roads[3].then[0].place((4,)), roads[1].otherwise[0].place((3,))] == [
        SegmentRound(1, (0,)),
        SegmentRound(1, (5,)),
        SegmentRound(4, ()),
    ]
    assert Road(7, 0, 300, (), 1, 1).place((2, 9)) == SegmentRound(7, (2, 0))


def test_results_of_the_round_before_travel_where_they_are_read_and_no_others() -> None:
    found = plan(
        {
            "repeat": [
                task("b1", "b"),
                {"if": "b1.out > 5", "then": [task("c1", "c", arguments={"x": "=b1.out"})], "else": [task("c2", "c")]},
            ],
            "times": 3,
        },
        task("last", "a", arguments={"x": "=c1.out"}),
    )
    needs = {one.space: one.needs for one in found.segments if one.steps and not isinstance(one.steps[0], BranchPoint)}
    head = next(one for one in found.segments if one.loops and isinstance(one.steps[0], BranchPoint))
    assert head.needs == [("c1.out",)], "b1 is done anew before it is read"
    assert needs[300] == [("c1.out",)]


def test_a_task_that_another_branch_waits_for_has_a_mailbox_there() -> None:
    one = [task("b1", "b"), task("b2", "b")]
    other = [task("c1", "c"), task("c2", "c", after=["b1"], arguments={"x": "=b1.out"})]
    found = plan(task("first", "a"), {"parallel": [one, other]})
    number, mailbox = next((n, one) for n, one in enumerate(found.segments) if one.tells)
    assert (mailbox.tells, mailbox.space, mailbox.needs) == ("b1", 302, [("b1.out",), ()])
    told = next(one for one in found.segments if Edge(number, MailSlot.DONE) in one.then)
    assert [step.name for step in told.steps if isinstance(step, Task)] == ["b1"], "and it does not wait for b2"
    assert [each.hears for each in found.segments if each.space == 302 and each.steps] == [[Hearing(number, 0)]]
    lost = [each.space for each in found.segments if Edge(number, MailSlot.LOST) in each.lost]
    assert lost == [301, 301], "what fails in that branch"


def test_what_one_bridge_does_in_branches_that_wait_for_each_other_stays_with_its_engine() -> None:
    one, other = [task("a1", "a"), task("a2", "a")], [task("a3", "a", after=["a1"])]
    assert len(plan({"parallel": [one, other]}).segments) == 1
    both = plan({"parallel": [[*one, task("a5", "a", after=["b1"])], [task("b1", "b", after=["a2"])]]})
    assert sorted(one.tells for one in both.segments if one.tells) == ["a2", "b1"]


def test_a_value_that_no_connection_brings_to_a_bridge_is_named() -> None:
    view = replace(VIEW, values={"c.level": 302, "b.level": 301}, hears={300: frozenset({301})})
    condition = {"if": "c.level > 3", "then": [task("one", "a")]}
    assert "the bridge of space 300 has no connection by which 'c.level' comes" in problems(condition, view=view)
    assert not problems({**condition, "if": "b.level > 3"}, view=view)


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ([task("one", "a"), {"wait": None, "event": "go"}], "'go' is sent to the server"),
        ([{"if": "a.order > 0", "then": task("one", "a")}], "'a.order' is a value of the server"),
        ([task("one", "elsewhere")], "no robot for it lives behind a bridge"),
    ],
)
def test_why_a_scenario_cannot_be_carried(steps: list[dict[str, Any]], said: str) -> None:
    assert said in problems(*steps)


def test_a_plan_whose_token_could_be_too_large_is_refused_with_its_size() -> None:
    tasks = [task(f"t{number}", "a") for number in range(20)]
    reading = [task(f"u{n}", "b", arguments={"x": f"=t{n}.out", "y": f"=t{n}.said"}) for n in range(20)]
    assert "a token of up to 1562 bytes, and it has 1200" in problems(*tasks, *reading)
    assert not problems(*tasks, *[task(f"u{n}", "b", arguments={"x": f"=t{n}.out"}) for n in range(20)])


def test_bridges_that_do_not_take_each_others_actions_are_named() -> None:
    view = replace(VIEW, requestors={**VIEW.requestors, 301: frozenset({0})})
    assert "the bridge of space 301 takes no Actions of space 300" in problems(
        task("one", "a"), task("two", "b"), view=view
    )
    assert not problems(task("one", "a"), task("two", "a"), view=view)


def test_a_part_has_its_own_segments_alone_and_the_hash_of_all() -> None:
    steps = task("one", "a"), task("two", "b", arguments={"x": "=one.out * factor"}), task("three", "c")
    found = parts_of(plan(*steps, parameters={"factor": 2.0}), "run", "made", {"factor": 3.0}, "anna")
    read = {space: decode_part(encode_part(part)) for space, part in found.items()}
    assert {space: encode_part(part) for space, part in read.items()} == {
        space: encode_part(part) for space, part in found.items()
    }
    assert [sorted(part.segments) for part in read.values()] == [[0], [1], [2]]
    assert len({part.plan_hash for part in read.values()}) == 1
    assert read[301].robots() == {"b"}
    other = parts_of(plan(*steps, parameters={"factor": 2.0}), "run", "made", {"factor": 4.0}, "anna")
    assert other[300].plan_hash != read[300].plan_hash


@pytest.mark.parametrize("content", [b"", b"x" * 100, b"x\x9c", bytes(40_000), encode_part(
    parts_of(plan(task("one", "a")), "run", "made", {}, "anna")[300])[:-9]])  # fmt: skip
def test_a_part_that_is_none_is_refused(content: bytes) -> None:
    with pytest.raises(PartInvalid):
        decode_part(content)


def test_steps_come_back_as_they_were() -> None:
    scenario = made(
        task("one", "a", arguments={"x": "20 deg"}, retries=2, timeout_s=5, on_unknown="retry"),
        {"task": "any", "skill": "work", "capacity": "B", "after": ["one"]},
        {
            "parallel": [
                [{"wait": 2}],
                [{"wait": None, "until": "one.out > 3", "timeout_s": 9, "on_timeout": "continue"}],
            ]
        },
        {"if": "one.out > 1", "then": {"end": "failed", "reason": "no"}, "else": {"sequence": [{"wait": 1}]}},
        {"repeat": [task("two", "b")], "times": 3, "while": "one.out < 4"},
    )
    read = decode_step(json.loads(json.dumps(encode_step(scenario.body))))
    assert _plain(read) == _plain(scenario.body)
    segment = segment_scenario("made", scenario.body, (2, 0), {"one.out": 3.5, "limit": True}, ["far"])
    assert _plain(decode_scenario(segment.text)) == _plain(segment)
    assert (segment.scope, segment.outside) == ("@2@0", frozenset(["far"]))
    deep: Any = {"key": "", "line": 0, "kind": "sequence", "steps": []}
    for _ in range(100):
        deep = {"key": "", "line": 0, "kind": "sequence", "steps": [deep]}
    for content in (deep, {}, None, {"key": "", "line": 0, "kind": "dance"}):
        with pytest.raises(FragmentInvalid):
            decode_step(content)


def _plain(value: object) -> str:
    """All of it as text; the trees of expressions, which are compared by their places, left out."""
    return re.sub(r"_tree=<[^>]*>", "", repr(value))


def test_spaces_that_follow_each_other_take_no_room() -> None:
    def part_of(count: int) -> bytes:
        robots = {f"r{number}": 300 + number for number in range(count)}
        skills = {name: RobotView(name, frozenset(), {"work": WORK}) for name in robots}
        mutual = dict.fromkeys(robots.values(), frozenset({0, *robots.values()}))
        view = PlanView(FleetView(skills), robots, mutual)
        found, problems = split(made(*[task(f"t_{name}", name) for name in robots]), view)
        assert found is not None, problems
        part = parts_of(found, "run", "made", {}, "eva")[300]
        assert decode_part(encode_part(part)) == part
        assert part.spaces == tuple(robots.values())
        return encode_part(part)

    assert len(part_of(200)) <= len(part_of(3)) + 8


@pytest.mark.parametrize("spaces", [[[0, 3]], [[5, 4]], [[1, 70_000]], [[1, 65_535]] * 3, [[1]], [1], "1"])
def test_spaces_that_there_are_not_are_refused(spaces: Any) -> None:
    part = parts_of(plan(task("one", "a")), "run", "made", {}, "eva")[300]
    data = json.loads(_json(part))
    data["spaces"] = spaces
    deflating = zlib.compressobj(zdict=_DICTIONARY)
    with pytest.raises(PartInvalid):
        decode_part(deflating.compress(json.dumps(data).encode()) + deflating.flush())


@pytest.mark.parametrize("number", ["Infinity", "-Infinity", "NaN", "1e999"])
@pytest.mark.parametrize("key", ["epoch", "lease_s", "adopt_after_s", "n"])
def test_a_part_with_a_number_that_is_none_is_refused(key: str, number: str) -> None:
    text = _json(parts_of(plan(task("one", "a")), "run", "made", {}, "anna")[300]).decode()
    changed, count = re.subn(rf'"{key}":[0-9.]+', f'"{key}":{number}', text)
    assert count == 1
    deflating = zlib.compressobj(9, zdict=_DICTIONARY)
    with pytest.raises(PartInvalid):
        decode_part(deflating.compress(changed.encode()) + deflating.flush())


@pytest.mark.parametrize("key", ["gone", "filled"])
def test_an_adoption_with_a_number_that_is_none_is_refused(key: str) -> None:
    part = parts_of(plan(task("one", "a")), "run", "made", {}, "anna")[300]
    made = Adoption(part, (301,), "anna", (FilledSlot(0, 0, "", {}),))
    data = json.loads(zlib.decompress(encode_adoption(made, encode_part(part))))
    data[key] = float("inf") if key == "gone" else [[float("inf"), *data[key][0][1:]]]
    with pytest.raises(PartInvalid):
        decode_adoption(zlib.compress(json.dumps(data).encode()))
