"""Scenarios as plans of segments: which bridge does what, where tokens go, and why a scenario cannot be carried."""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import replace
from typing import Any

import pytest

from ua_fleet.carrying import PlanView, decode_part, encode_part, parts_of, split
from ua_fleet.carrying.fragments import FragmentInvalid, decode_scenario, decode_step, encode_step, segment_scenario
from ua_fleet.carrying.part import _DICTIONARY, PartInvalid, _json  # pyright: ignore[reportPrivateUsage]
from ua_fleet.carrying.plan import Edge, Plan
from ua_fleet.carrying.token import WHOLE
from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.scenario import FleetView, RobotView, scenario_of
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
        (),
        ("one.out",),
        ("one.out", "two.out"),
        ("one.out", "two.out"),
        (),
    ]


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ([task("one", "a"), {"wait": None, "event": "go"}], "'go' is told to the server"),
        ([{"if": "a.order > 0", "then": task("one", "a")}], "'a.order' is said by the server"),
        ([{"repeat": [task("one", "a"), task("two", "b")], "times": 2}], "the `repeat` has tasks of several bridges"),
        ([task("one", "elsewhere")], "no robot for it lives behind a bridge"),
        (
            [{"parallel": [[task("one", "a")], [task("two", "b", after=["one"])]]}],
            "comes after 'one', which another bridge does in another branch",
        ),
        (
            [{"parallel": [[task("one", "a")], [task("two", "b", arguments={"x": "=one.out"})]]}],
            "'one.out' is a result of another branch",
        ),
    ],
)
def test_why_a_scenario_cannot_be_carried(steps: list[dict[str, Any]], said: str) -> None:
    assert said in problems(*steps)


def test_a_plan_whose_token_could_be_too_large_is_refused_with_its_size() -> None:
    tasks = [task(f"t{number}", "a") for number in range(20)]
    reading = [task(f"u{n}", "b", arguments={"x": f"=t{n}.out", "y": f"=t{n}.said"}) for n in range(20)]
    assert "a token of up to 1561 bytes, and it has 1200" in problems(*tasks, *reading)
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
    segment = segment_scenario("made", scenario.body, {"one.out": 3.5, "limit": True})
    assert _plain(decode_scenario(segment.text)) == _plain(segment)
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
