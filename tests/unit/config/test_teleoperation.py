"""Teleoperation in `fleet.yaml`: its ids, its model, and what `config check` refuses."""

from __future__ import annotations

import pytest

from ua_fleet.config.assign_ids import insert_ids
from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.registration import announced_robots
from ua_fleet.config.security import weaknesses
from ua_fleet.config.teleoperation import setpoint_groups, teleoperations
from ua_fleet.errors import ConfigInvalid
from ua_fleet.teleoperation import AxisLimits, SetpointAddress
from ua_fleet.topics import Topic

FILE = """\
version: 1
pubsub: {security: none}
bridges:
  floor: {kind: ros2, space: 2, status_id: 1001}
  hall: {kind: tcp, space: 300, status_id: 1002, direct: {connect: "10.0.0.7:30002"}}
robots:
  carrier:
    bridge: floor
    skill_status_id: 1010
    data:
      cmd_vel:
        id: 1003
        origin: server
        fields:
          linear: {type: Double, unit: m/s, path: linear.x}
          angular: {type: Float, unit: rad/s, path: angular.z}
        sink: {topic: /cmd_vel, type: geometry_msgs/Twist}
      lamp: {id: 1004, origin: server, type: Boolean, sink: {topic: /lamp, type: std_msgs/Bool}}
      pose: {id: 1005, type: Double, source: {topic: /pose, type: std_msgs/Float64}}
    skills: {wave: {id: 1011}}
    teleoperation:
      id: 1006
      acquire_id: 1007
      renew_id: 1008
      release_id: 1009
      data: cmd_vel
      axes:
        angular: {speed: 1.0, acceleration: 2.0, jerk: 8.0}
        linear: {speed: 0.5, acceleration: 0.5, deceleration: 1.0, jerk: 2.0}
      robot_timeout_ms: 500
"""


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load_content(text.encode(), "f.yaml", {})
    return [str(problem) for problem in caught.value.problems]


def changed(*pairs: tuple[str, str]) -> str:
    text = FILE
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_the_model_has_the_axes_in_the_order_of_the_data() -> None:
    config = load_content(FILE.encode(), "f.yaml", {})
    (model,) = teleoperations(config, "floor")
    assert teleoperations(config, "hall") == ()
    assert model.axes == (("linear", AxisLimits(0.5, 0.5, 1.0, 2.0)), ("angular", AxisLimits(1.0, 2.0, 2.0, 8.0)))
    assert (model.deadman_s, model.robot_timeout_s, model.period_s) == (0.3, 0.5, 0.02)
    assert (model.data, model.status) == (Topic(0, 2, 1003), Topic(2, 2, 1006))
    assert model.actions == (Topic(2, 2, 1007), Topic(2, 2, 1008), Topic(2, 2, 1009))
    assert model.setpoints == SetpointAddress(1001, 1006)
    assert model.units == ("m/s", "rad/s")
    assert setpoint_groups(config) == {1001: 2}
    (robot,) = fleet_model(config).robots
    assert robot.teleoperation == model


def test_clients_do_not_write_what_takes_setpoints() -> None:
    (robot,) = fleet_model(load_content(FILE.encode(), "f.yaml", {})).robots
    assert {data.name: data.writable for data in robot.data_sets} == {"cmd_vel": False, "lamp": True, "pose": False}


def test_a_single_field_is_the_axis_value() -> None:
    text = changed(
        ("        fields:\n          linear: {type: Double, unit: m/s, path: linear.x}\n", "        type: Double\n"),
        ("          angular: {type: Float, unit: rad/s, path: angular.z}\n", "        path: linear.x\n"),
        ("        angular: {speed: 1.0, acceleration: 2.0, jerk: 8.0}\n", ""),
        ("        linear: {sp", "        value: {sp"),
    )
    (model,) = teleoperations(load_content(text.encode(), "f.yaml", {}), "floor")
    assert [name for name, _ in model.axes] == ["value"]


@pytest.mark.parametrize("layout", ["block", "flow"])
def test_missing_ids_are_asked_for_and_assigned(layout: str) -> None:
    ids = "      id: 1006\n      acquire_id: 1007\n      renew_id: 1008\n      release_id: 1009\n"
    text = changed((ids, ""))
    if layout == "flow":
        head, _, tail = text.partition("    teleoperation:\n")
        lines = [line.strip() for line in tail.splitlines()]
        data, axes, angular, linear, timeout = lines
        text = f"{head}    teleoperation: {{{data}, {axes} {{{angular}, {linear}}}, {timeout}}}\n"
    said = problems(text)
    assert len(said) == 4
    assert (
        "robots.carrier.teleoperation.release_id: `release_id` is missing; run: ua-fleet config assign-ids" in said[3]
    )
    content, given = insert_ids(text.encode(), "f.yaml")
    assert list(given.values()) == [1012, 1013, 1014, 1015]
    (model,) = teleoperations(load_content(content, "f.yaml", {}), "floor")
    assert (model.status.id, model.acquire.id, model.renew.id, model.release.id) == (1012, 1013, 1014, 1015)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("      robot_timeout_ms: 500\n", "", "`robot_timeout_ms` is missing; add `robot_timeout_ms: 500`"),
        ("robot_timeout_ms: 500", "robot_timeout_ms: 50", "50 ms are less than 3 periods of 20 ms"),
        ("robot_timeout_ms: 500", "robot_timeout_ms: 500\n      deadman_ms: 20", "deadman_ms: must be at least 100"),
        ("acquire_id: 1007", "acquire_id: 1003", "1003 is in use already (robots.carrier.data.cmd_vel.id, line 12)"),
        ("data: cmd_vel", "data: cmd_val", "carrier has no data `cmd_val`; did you mean `cmd_vel`?"),
        ("data: cmd_vel", "data: pose", "`pose` comes from the robot; name data of origin server"),
        ("        sink: {topic: /cmd_vel, type: geometry_msgs/Twist}\n", "", "`cmd_vel` has no `sink`"),
        ("linear: {type: Double, unit", "linear: {type: Int32, unit", "an axis is a single Float or Double"),
        ("{type: Double, unit", "{type: Double, array: true, unit", "an axis is a single Float or Double"),
        ("unit: m/s, path", "unit: m/s, initial: 0.1, path", "initial: what takes setpoints has no initial value"),
        ("unit: m/s, path", "range: [-0.4, 1], path", "speed: 0.5 is beyond the range of the field, -0.4 to 1"),
        ("  angular: {speed", "  angluar: {speed", "`cmd_vel` has no field `angluar`; did you mean `angular`?"),
        ("speed: 1.0", "speed: 0", "speed: must be greater than 0"),
        ("speed: 1.0", "speed: .inf", "speed: must be"),
        ("jerk: 8.0", "jerk: 0.08", "axes.angular: a stop of this axis may take 50.5 s, at most 30 s are legal"),
        ("jerk: 8.0", "jerk: 5.0e-324", "axes.angular: a stop of this axis may take inf s"),
        ("deceleration: 1.0", "deceleration: 0.01", "axes.linear: a stop of this axis may take 50.3 s"),
        ("Twist}", "Twist, max_rate_hz: 5}", "setpoints are written each `period_ms` of teleoperation"),
        ("Twist}", "Twist, latched: true}", "a setpoint must not be kept for late subscribers"),
        ("Twist}", "Twist, qos: {durability: transient_local}}", "a setpoint must not be kept for late subscribers"),
        ("type: Boolean, sink: {topic: /lamp, type: std_msgs/Bool}", (
            "type: Double, path: linear.z, sink: {topic: cmd_vel, type: geometry_msgs/Twist}"
        ), "/cmd_vel is written by carrier.lamp too, and a robot has one commander"),
        ("status_id: 1001}", "status_id: 1001, requestors: [3]}", "the server may not command floor"),
        ("status_id: 1001}", "status_id: 2}", "2 is the index of a namespace, and setpoints need a WriterGroup"),
    ],
)  # fmt: skip
def test_mistakes(old: str, new: str, said: str) -> None:
    found = problems(changed((old, new)))
    assert [one for one in found if said in one], found
    assert all("\n" not in one for one in found)


def test_robots_of_other_kinds_are_refused_with_those_that_can() -> None:
    text = changed(("bridge: floor", "bridge: hall"))
    said = [one for one in problems(text) if "teleoperation" in one]
    assert "robots on a bridge of kind tcp cannot be driven by hand" in said[0]
    assert "those on bridges of these kinds can: `ros1`, `ros2`, `ur`" in said[0]


def test_without_security_it_is_said_who_can_drive() -> None:
    (said,) = weaknesses(load_content(FILE.encode(), "f.yaml", {}))
    assert said.endswith("can read and forge them, and drive carrier")


def test_a_bridge_announces_nothing_of_it() -> None:
    (text,) = announced_robots(load_content(FILE.encode(), "f.yaml", {}), "floor").values()
    assert "teleoperation" not in text
