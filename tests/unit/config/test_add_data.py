"""Topics that are seen, as data of the file: what is written, where, and what is left out."""

from __future__ import annotations

import pytest
import yaml
from ua_bridges.ros.topic_mapping import TopicMapping

from ua_fleet.config.add_data import insert_data
from ua_fleet.config.base import ScalarType
from ua_fleet.config.schema import DataSetConfig, RobotConfig
from ua_fleet.config.topics_seen import Addition, FieldSeen, TopicSeen, plan_additions
from ua_fleet.errors import ConfigInvalid

LIMIT = TopicSeen("/limit", "std_msgs/Float64", True, (FieldSeen("data", ScalarType.DOUBLE),))
POSE = TopicSeen(
    "/pose", "hall_msgs/Pose", False, (FieldSeen("at.x", ScalarType.DOUBLE), FieldSeen("ids", ScalarType.INT32, True))
)
MODE = TopicSeen("/mode", "hall_msgs/Mode", False, (FieldSeen("word", ScalarType.STRING),), True)
HEAD = "version: 1\npubsub: {security: none}\nbridges:\n  floor: {kind: ros2, space: 2, status_id: 1}\n"


def written(text: str, robot: str = "carrier", seen: TopicSeen = LIMIT) -> str:
    return insert_data(text.encode(), "f.yaml", "floor", [Addition(robot, "new", seen, None)]).decode()


def test_how_a_data_source_is_written() -> None:
    assert Addition("r", "limit", LIMIT, None).lines() == [
        "limit:",
        "  origin: server",
        "  type: Double",
        "  sink: {topic: /limit, type: std_msgs/Float64}",
    ]
    assert Addition("r", "pose", POSE, 2.5).lines() == [
        "pose:",
        "  fields:",
        "    at.x: {type: Double}",
        "    ids: {type: Int32, array: true}",
        "  source: {topic: /pose, type: hall_msgs/Pose, max_rate_hz: 2.5}",
    ]
    assert Addition("r", "mode", MODE, None).lines()[1:3] == ["  type: String", "  path: word"]


NEW = "new:\n{0}  origin: server\n{0}  type: Double\n{0}  sink: {{topic: /limit, type: std_msgs/Float64}}\n"


def indented(columns: int) -> str:
    return " " * columns + NEW.format(" " * columns)


CARRIER = "carrier:\n    bridge: floor\n    data:\n"
DATA = "robots:\n  carrier:\n    data:\n"
FOLDED = "      a:\n        description: >\n          b: c\n\n          d\n        type: Double\n"


@pytest.mark.parametrize(
    ("before", "after", "columns"),
    [
        ("      # of it\n      a: {type: Double} # x\n", "", 6),
        ("      a:\n        type: Double\n        # within\n", "\n    # on\n    bridge: floor\n", 6),
        ("        a: {type: Double}\n", "\n# the end\n", 8),
        ("      a: {type: Double}\n", "  ned: {bridge: floor}\n", 6),
        (FOLDED, "    bridge: floor\n", 6),
    ],
)
def test_it_comes_after_the_last_data_of_its_robot(before: str, after: str, columns: int) -> None:
    assert written(HEAD + DATA + before + after) == HEAD + DATA + before + indented(columns) + after


@pytest.mark.parametrize(
    ("before", "after", "around"),
    [
        ("robots:\n  carrier:\n    bridge: floor\n", "# end\n", "    data:\n"),
        ("robots:\n  carrier:\n    bridge: floor\n    capacities:\n    - mobile\n", "", "    data:\n"),
        (
            "robots:\n  ned:\n    bridge: floor\n",
            "\nserver:\n  port: 1\n",
            "  carrier:\n    bridge: floor\n    data:\n",
        ),
        ("", "", f"robots:\n  {CARRIER}"),
    ],
)
def test_what_is_not_there_yet_is_written_around_it(before: str, after: str, around: str) -> None:
    assert written(HEAD + before + after) == HEAD + before + around + indented(6) + after


def test_the_ends_of_lines_and_a_mark_at_the_start_stay() -> None:
    text = "\ufeff" + (HEAD + "robots:\n  carrier:\n    bridge: floor").replace("\n", "\r\n")
    new = "    data:\n" + indented(6)
    assert written(text) == text + ("\n" + new).replace("\n", "\r\n")


@pytest.mark.parametrize(
    "robots",
    [
        "robots: {carrier: {bridge: floor}}\n",
        "robots:\n  carrier: {bridge: floor}\n",
        "robots:\n  carrier:\n    bridge: floor\n    data: {a: {type: Double}}\n",
        "robots:\n  carrier:\n    bridge: floor\n    data: {}\n",
        "robots:\n  carrier:\n    bridge: floor\n    data:\n",
    ],
)
def test_where_there_is_no_place_nothing_is_written(robots: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        written(HEAD + robots)
    (problem,) = caught.value.problems
    assert "the layout here has no place for more data; write it as a block" in str(problem)


def robot(bridge: str = "floor", **data: tuple[str, str]) -> RobotConfig:
    """A robot with data by name, each on a side with a topic."""
    sets = {
        name: DataSetConfig(type=ScalarType.DOUBLE).model_copy(
            update={side: TopicMapping(topic=topic, type="std_msgs/Float64")}
        )
        for name, (side, topic) in data.items()
    }
    return RobotConfig(bridge=bridge).model_copy(update={"data": sets})


def seen(topic: str, *, is_command: bool = False, is_latched: bool = False, problem: str = "") -> TopicSeen:
    fields = () if problem else (FieldSeen("data", ScalarType.DOUBLE),)
    return TopicSeen(topic, "std_msgs/Float64", is_command, fields, is_latched, problem)


def test_names_and_robots_follow_the_topics() -> None:
    topics = ["/agv_1/arm/x", "/agv_1/1st", "/ned/x", "/ua_2_2_7", "/x"]
    plan = plan_additions(map(seen, topics), {"agv-1": robot(), "ned": robot(x=("source", "/old"))}, "floor")
    assert [(one.robot, one.name) for one in plan.additions] == [("agv-1", "st"), ("agv-1", "arm_x"), ("ned", "x_2")]
    assert plan.left_out == (("/x", "whose is it? give --robot; robots of this bridge: agv-1, ned"),)
    plan = plan_additions(map(seen, topics), {"ned": robot()}, "floor", robot="new", pattern="/agv*")
    assert [(one.robot, one.name) for one in plan.additions] == [
        ("new", "agv_1_1st"),
        ("new", "agv_1_arm_x"),
    ]


def test_what_is_mapped_or_cannot_be_is_left_out_with_the_reason() -> None:
    robots = {"ned": robot(a=("source", "a"), b=("sink", "/b")), "far": robot("cell", c=("source", "/c"))}
    empty = TopicSeen("/empty", "std_msgs/Empty", False)
    much = TopicSeen("/much", "a/B", False, tuple(FieldSeen(f"f{n}", ScalarType.DOUBLE) for n in range(1991)))
    topics = [seen("/a"), seen("/b", is_command=True), seen("/c"), seen("/d", problem="not installed"), empty, much]
    plan = plan_additions(topics, robots, "floor")
    assert [one.seen.topic for one in plan.additions] == ["/c"]
    assert dict(plan.left_out) == {
        "/a": "mapped already: robots.ned.data.a",
        "/b": "mapped already: robots.ned.data.b",
        "/d": "not installed",
        "/empty": "std_msgs/Empty has no value that can be mapped by itself",
        "/much": "a/B has 1991 values, 1990 are the most",
    }


def test_only_what_is_read_and_not_latched_has_a_rate() -> None:
    topics = [seen("/a"), seen("/b", is_command=True), seen("/c", is_latched=True)]
    plan = plan_additions(topics, {"ned": robot()}, "floor", max_rate_hz=5)
    assert [one.max_rate_hz for one in plan.additions] == [5, None, None]


@pytest.mark.parametrize(
    ("topic", "kind", "reason"),
    [
        ("/carrier/a.b", "std_msgs/Float64", "no ROS name"),
        ("/carrier/\x1b[2J\u00e9", "std_msgs/Float64", "no ROS name"),
        ("/x, max_rate_hz: 500", "std_msgs/Float64", "no ROS name"),
        ("/x}\n      goal: {type: Double", "std_msgs/Float64", "no ROS name"),
        ("/carrier-1/x", "std_msgs/Float64", "no ROS name"),
        ("/1st", "std_msgs/Float64", "no ROS name"),
        ("/x", "std_msgs/Float_64", "no message type"),
        ("/x", "std_msgs/Float64}#", "no message type"),
        ("/x", "std_msgs/Float64, path: y", "no message type"),
    ],
)
def test_what_is_no_ros_name_does_not_get_into_the_file(topic: str, kind: str, reason: str) -> None:
    seen = TopicSeen(topic, kind, False, LIMIT.fields)
    plan = plan_additions([seen], {"carrier": RobotConfig(bridge="floor")}, "floor")
    assert not plan.additions
    assert reason in plan.left_out[0].reason


def test_a_field_whose_name_fleet_yaml_does_not_take_leaves_its_topic_out() -> None:
    odd = TopicSeen("/odd", "a/B", False, (FieldSeen("x", ScalarType.DOUBLE), FieldSeen("y" * 129, ScalarType.DOUBLE)))
    plan = plan_additions([odd, seen("/x")], {"ned": robot()}, "floor")
    assert [one.seen.topic for one in plan.additions] == ["/x"]
    assert plan.left_out[0].reason.startswith("a/B has a field whose name fleet.yaml does not take: yyy")


def test_names_that_yaml_takes_for_something_else_stay_names() -> None:
    fields = (FieldSeen("on", ScalarType.DOUBLE), FieldSeen("no", ScalarType.DOUBLE))
    plan = plan_additions(
        [TopicSeen("/carrier/null", "hall_msgs/Lamp", False, fields)], {"carrier": RobotConfig(bridge="floor")}, "floor"
    )
    content = insert_data((HEAD + DATA + "      a: {type: Double}\n").encode(), "f.yaml", "floor", plan.additions)
    data = yaml.safe_load(content)["robots"]["carrier"]["data"]
    assert list(data) == ["a", "null"]
    assert list(data["null"]["fields"]) == ["on", "no"]


def test_a_robot_whose_name_yaml_would_take_for_something_else() -> None:
    assert "robots:\n  'on':\n    bridge: floor\n" in written(HEAD, "on")
