"""Robots that stand in no file: read from text, with every mistake and its line."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from ua_fleet.config.registration import MOST_BYTES, Definition, RobotText, definition_text, read_robot
from ua_fleet.config.schema import FleetConfig, RobotConfig
from ua_fleet.errors import ConfigInvalid
from ua_fleet.topics import Topic

FLEET = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"yard": {"kind": "virtual", "space": 300, "status_id": 900}},
    }
)
TEXT = textwrap.dedent("""\
    description: Carries boxes
    capacities: [carry]
    skill_status_id: 1510
    data:
      battery: {id: 1501, type: Double, unit: "%", range: [0, 100]}
    skills:
      drive:
        id: 1502
        needs: [carry]
        arguments:
          metres: {type: Double, unit: m, range: [0, 50], default: 1}
        results:
          driven: {type: Double, unit: m}
        timeout_s: 30
    """)


def nobody(_topic: Topic) -> Topic | str | None:
    return None


def problems(said: RobotText, owner_of: Any = nobody) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        read_robot(said, FLEET, owner_of)
    return [str(problem) for problem in caught.value.problems]


def read(text: str = TEXT, bridge: str = "yard", owner_of: Any = nobody, **more: Any) -> Definition:
    return read_robot(RobotText("cart", bridge, text=text, **more), FLEET, owner_of)


def test_a_robot_is_what_it_would_be_in_the_file() -> None:
    robot = read().model
    assert (robot.name, robot.bridge, robot.description, robot.capacities) == (
        "cart",
        "yard",
        "Carries boxes",
        ("carry",),
    )
    assert robot.skill_status == Topic(300, 2, 1510)
    assert [data_set.topic for data_set in robot.data_sets] == [Topic(300, 2, 1501)]
    (drive,) = robot.skills
    assert (drive.id, drive.timeout_s, drive.arguments[0].range, drive.results[0].unit) == (1502, 30, (0, 50), "m")


def test_a_file_with_several_robots_will_do() -> None:
    text = "version: 1\nrobots:\n  other: {}\n  cart:\n" + textwrap.indent(TEXT, "    ")
    assert read(text).model == read().model
    wrong = text.replace("type: Double, unit: m, range: [0, 50]", "type: Doble")
    (problem,) = problems(RobotText("cart", "yard", text=wrong, file="yard.yaml"))
    assert problem.startswith("yard.yaml:15:robots.cart.skills.drive.arguments.metres.type: ")
    assert "there is no robot `card`" in problems(RobotText("card", "yard", text=text))[0]


def test_what_is_given_beside_the_text_goes_before_it() -> None:
    robot = read(capacities=("carry", "lift"), description="Lifts, too").model
    assert (robot.capacities, robot.description) == (("carry", "lift"), "Lifts, too")


def test_the_number_of_a_space_that_no_bridge_of_the_file_has_will_do() -> None:
    assert read(bridge="301").model.skill_status == Topic(301, 2, 1510)
    assert read(bridge="301").model.bridge == ""
    assert read(bridge="300").model == read().model


def test_all_problems_are_told_with_their_lines() -> None:
    text = TEXT.replace("needs: [carry]", "needs: [fly]").replace("id: 1502", "").replace("range: [0, 100]", "rng: 1")
    said = problems(RobotText("cart", "yrd", text=text))
    assert [line.split(": ", 1)[0] for line in said] == [
        "definition:robots.cart.bridge",
        "definition:5:robots.cart.data.battery.rng",
        "definition:7:robots.cart.skills.drive.id",
        "definition:9:robots.cart.skills.drive.needs[0]",
    ]
    assert "there is no bridge `yrd`; did you mean `yard`?" in said[0]
    assert "rng" in said[1]
    assert "`id` is missing; write the id that its bridge uses for it" in said[2]
    assert "cart lacks the capacity `fly`" in said[3]


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (RobotText("9lives", "yard"), "`9lives` is not allowed as a name"),
        (RobotText("cart", "240"), "space ids 233..255 are reserved"),
        (RobotText("cart", "yard", text="a: [1"), "is not YAML"),
        (RobotText("cart", "yard", text="a: &b 1"), "anchors"),
        (RobotText("cart", "yard", text="#" * MOST_BYTES + "##"), "longer than 64 KiB"),
        (
            RobotText("cart", "yard", text="data: {x: {id: 5, type: Double}, y: {id: 5, type: Double}}"),
            "in use already",
        ),
        (RobotText("cart", text="data: {x: {type: Double}}"), "write `origin: server`"),
    ],
)
def test_what_is_no_robot_is_refused(said: RobotText, expected: str) -> None:
    assert expected in problems(said)[0]


def owns(owners: Mapping[int, Topic | str]) -> Callable[[Topic], Topic | str | None]:
    return lambda topic: owners.get(topic.id)


def test_ids_belong_to_one_thing() -> None:
    assert read(owner_of=owns({1501: Topic(300, 2, 1501)})).model == read().model  # it was discovered before
    (problem,) = problems(RobotText("cart", "yard", text=TEXT), owns({1501: Topic(301, 2, 1501)}))
    assert "1501 is in use already (ua_301_2_1501)" in problem
    (problem,) = problems(RobotText("cart", "yard", text=TEXT), owns({1510: "robots.arm"}))
    assert problem.startswith("definition:3:robots.cart.skill_status_id: 1510 is in use already (robots.arm)")


def test_a_robot_of_clients_gets_ids_that_are_free() -> None:
    text = "skills: {help: {}, look: {id: 1003}}\ndata: {note: {type: String, origin: server}}"
    robot = read(text, "", owns({1001: "robots.arm"})).model
    assert [skill.id for skill in robot.skills] == [1004, 1003]
    assert (robot.data_sets[0].topic, robot.skill_status) == (Topic(0, 2, 1002), Topic(0, 2, 1005))


def test_what_was_read_can_be_kept_and_read_again() -> None:
    for bridge in ("yard", "301"):
        first = read(bridge=bridge)
        assert read_robot(first.text, FLEET, nobody) == first
    config = RobotConfig.model_validate(
        {"bridge": "yard", "skills": {"drive": {"id": 1502, "via": {"topic": "/drive"}}}}
    )
    assert definition_text("cart", config) == '{"robots":{"cart":{"skills":{"drive":{"id":1502}}}}}'
