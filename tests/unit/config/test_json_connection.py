"""JSON in `fleet.yaml`: the roads that it goes, what it must not carry, and what a process makes of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ua_fleet.config.applications import bridge_application
from ua_fleet.config.connections import unstartable
from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import data_topics
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import envelope_of, keys_needed, weaknesses
from ua_fleet.config.transports import open_transport
from ua_fleet.counters import Counters
from ua_fleet.errors import ConfigInvalid
from ua_fleet.pubsub.application import MQTT_JSON
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.transport import MqttTransport
from ua_fleet.wire.json import Form
from ua_fleet.wire.security import SecurityMode

FLEET = """\
version: 1
fleet: {{name: Hall}}
pubsub:
  security: {security}
  url: {url}
  encoding: {encoding}
  actions: {actions}
bridges:
  floor: {{kind: ros2, space: 2, status_id: 1{bridge}}}
robots:
  carrier:
    bridge: floor
    skill_status_id: 1010
    data:
      cmd_vel:
        id: 1003
        origin: server
        fields: {{linear: {{type: Double, path: linear.x}}}}
        sink: {{topic: /cmd_vel, type: geometry_msgs/Twist}}
    skills: {{wave: {{id: 1011}}}}
{robot}"""

DRIVEN = """\
    teleoperation:
      id: 1006
      acquire_id: 1007
      renew_id: 1008
      release_id: 1009
      data: cmd_vel
      axes: {linear: {speed: 0.5, acceleration: 0.5, jerk: 2.0}}
      robot_timeout_ms: 500
"""


def fleet(
    security: str = "broker",
    url: str = "mqtts://broker",
    encoding: str = "json",
    *,
    actions: bool = False,
    bridge: str = "",
    robot: str = "",
) -> FleetConfig:
    text = FLEET.format(
        security=security, url=url, encoding=encoding, actions=str(actions).lower(), bridge=bridge, robot=robot
    )
    return load_content(text.encode(), "fleet.yaml", {})


@pytest.mark.parametrize(
    ("arguments", "key", "text"),
    [
        ({"url": "opc.udp://224.0.2.14:4840"}, "pubsub.encoding", "not over UDP"),
        ({"security": "none"}, "pubsub.security", "write `broker`"),
        ({"security": "sign_and_encrypt"}, "pubsub.security", "write `broker`"),
        ({"encoding": "uadp"}, "pubsub.security", "sign_and_encrypt"),
        ({"encoding": "xml"}, "pubsub.encoding", "json"),
        ({"bridge": ", publisher_id: hall-1"}, "bridges.floor.publisher_id", "its space"),
        ({"robot": DRIVEN}, "robots.carrier.teleoperation", "never go over JSON"),
    ],
)
def test_what_json_cannot_do_is_told_with_its_place(arguments: dict[str, Any], key: str, text: str) -> None:
    with pytest.raises(ConfigInvalid) as raised:
        fleet(**arguments)
    (problem,) = raised.value.problems
    assert problem.key == key
    assert text in f"{problem.message} {problem.suggestion}"


def test_the_data_that_the_file_names_is_known_and_never_shown_as_a_text() -> None:
    assert data_topics(fleet()) == {Topic(0, 2, 1003)}


def test_a_robot_that_is_driven_goes_with_uadp() -> None:
    assert fleet("none", encoding="uadp", robot=DRIVEN).robots["carrier"].teleoperation is not None


@pytest.mark.parametrize("actions", [False, True])
def test_a_robot_that_is_driven_cannot_be_taken_over_json(actions: bool) -> None:
    two = f"""\
version: 1
fleet: {{name: Hall}}
pubsub:
  - {{name: hall, security: none}}
  - {{name: site, security: broker, url: "mqtts://broker", encoding: json, actions: {str(actions).lower()}}}
"""
    one = FLEET.format(security="", url="", encoding="", actions="", bridge=", connections: [hall, site]", robot=DRIVEN)
    content = (two + one[one.index("bridges:") :]).encode()
    if not actions:
        assert load_content(content, "fleet.yaml", {}).robots["carrier"].teleoperation is not None
        return
    with pytest.raises(ConfigInvalid) as raised:
        load_content(content, "fleet.yaml", {})
    (problem,) = raised.value.problems
    assert problem.key == "robots.carrier.teleoperation"
    assert "could be taken over JSON" in problem.message


def test_a_process_needs_no_keys_and_secures_nothing(tmp_path: Path) -> None:
    config = fleet()
    assert keys_needed(config, 0, None) is None
    assert envelope_of(config, 2, Counters(), tmp_path).mode is SecurityMode.NONE
    assert not list(tmp_path.iterdir())


def test_each_process_says_in_one_line_that_there_is_no_tls() -> None:
    assert weaknesses(fleet()) == []
    (line,) = weaknesses(fleet(url="mqtt://broker"))
    assert "JSON without TLS" in line
    assert "command robots" not in line
    (line,) = weaknesses(fleet(url="mqtt://broker", actions=True))
    assert "command robots" in line


def test_skills_that_nobody_can_start_are_told() -> None:
    (line,) = unstartable(fleet())
    assert line == "skills of carrier cannot be started: their PubSub is JSON without `actions: true`"
    assert not unstartable(fleet(actions=True))
    assert not unstartable(fleet("none", encoding="uadp"))


def test_a_process_has_a_transport_of_json_and_says_so(tmp_path: Path) -> None:
    config = fleet(actions=True)
    assert isinstance(open_transport(config, tmp_path, space=2), MqttTransport)
    application = bridge_application(config, "floor")
    assert (application.profile, application.json_form) == (MQTT_JSON, Form.VERBOSE)
