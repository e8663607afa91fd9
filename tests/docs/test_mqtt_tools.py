"""The how-tos for Node-RED, Telegraf and Grafana: what can be run is; of the rest all names are those published."""

from __future__ import annotations

import json
import re
import subprocess
import tomllib
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests import system
from tests.docs.walkthrough import PASSWORD, Walk
from tests.unit.docs.pages import ROOT
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

pytestmark = pytest.mark.needs("mosquitto", "node-red")
PAGES = ROOT / "docs" / "how-to"
READ_BY_OTHERS = PAGES / "telegraf-grafana.md"
GO_LAYOUT = {"2006-01-02T15:04:05Z07:00": datetime.fromisoformat}
"""What parses a text as Go does by that layout, which takes digits behind the second too."""


class Seen:
    """What the broker retains when the page has been walked through."""

    def __init__(self, port: int) -> None:
        command = ["mosquitto_sub", "-p", str(port), "-t", "#", "-F", "%t %p", "--retained-only", "-W", "2"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        lines = [line.partition(" ") for line in done.stdout.splitlines()]
        self.messages: dict[str, dict[str, Any]] = {topic: json.loads(text) for topic, _, text in lines}


def levels_match(pattern: str, topic: str) -> bool:
    """Whether a subscription without `#` gets a topic."""
    wanted, given = pattern.split("/"), topic.split("/")
    return len(wanted) == len(given) and all(one in ("+", other) for one, other in zip(wanted, given, strict=True))


def named(pattern: str, topic: str) -> Iterator[tuple[str, str]]:
    """What topic parsing calls the levels of a topic."""
    yield from ((name, level) for name, level in zip(pattern.split("/"), topic.split("/"), strict=True) if name != "_")


def test_the_pages(folder: Path, environment: dict[str, str], processes: system.Processes) -> None:
    users = UserStore(folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir()
    users.add("anna", PASSWORD, Role.OPERATOR)
    environment["UA_FLEET__SERVER__TRUST_ALL_CLIENTS"] = "true"
    environment["PATH"] = f"{system.node_red().parent}:{environment['PATH']}"
    port = system.free_tcp_port()
    instead = {
        "1883": str(port),
        "1880": str(system.free_tcp_port()),
        "127.0.0.1:1025": f"127.0.0.1:{system.free_tcp_port()}",
    }
    Walk(folder, processes, environment, instead).walk(PAGES / "node-red.md")
    Walk(folder, processes, environment, {"1883": str(port)}).walk(READ_BY_OTHERS)
    seen = Seen(port).messages
    assert set(seen["plant/Fleet/press/position.x"]) == {"value", "time", "quality"}
    check_telegraf(tomllib.loads((folder / "telegraf.conf").read_text()), seen, port)
    check_grafana(folder, seen, port)


def check_telegraf(config: dict[str, Any], seen: dict[str, dict[str, Any]], port: int) -> None:
    """Topics, levels, members and times are those that the server publishes."""
    (consumer,) = config["inputs"]["mqtt_consumer"]
    assert consumer["servers"] == [f"tcp://127.0.0.1:{port}"]
    (topics,) = consumer["topics"]
    (parsing,) = consumer["topic_parsing"]
    (parser,) = consumer["json_v2"]
    found = {topic: message for topic, message in seen.items() if levels_match(topics, topic)}
    assert {topic.rpartition("/")[2] for topic in found} == {"position.x", "position.y", "_state", "_task", "_fault"}
    assert parsing["topic"] == topics
    (field,), (tag,) = parser["field"], parser["tag"]
    parse = GO_LAYOUT[parser["timestamp_format"]]
    for topic, message in found.items():
        assert {field["path"], tag["path"], parser["timestamp_path"]} == set(message)
        assert parse(message[parser["timestamp_path"]]).tzinfo is not None
        tags = dict(named(parsing["tags"], topic))
        assert tags == {"site": "plant", "fleet": "Fleet", "robot": "press"}
        assert dict(named(parsing["measurement"], topic)) == {"measurement": topic.rpartition("/")[2]}
    assert consumer["tagpass"] == {tag["path"]: [found["plant/Fleet/press/_state"][tag["path"]]]}


def check_grafana(folder: Path, seen: dict[str, dict[str, Any]], port: int) -> None:
    """The data source is this broker; the query asks for what Telegraf writes of a value that there is."""
    made = yaml.safe_load((folder / "grafana/provisioning/datasources/fleet.yaml").read_text())
    (source,) = made["datasources"]
    assert source["jsonData"]["uri"] == f"tcp://127.0.0.1:{port}"
    asked = dict(re.findall(r'r\.(\w+) == "([^"]+)"', (folder / "press.flux").read_text()))
    assert f"plant/Fleet/{asked['robot']}/{asked['_measurement']}" in seen
    assert asked["_field"] == "value"
    (topic,) = re.findall(r"the topic of its query is `([^`]+)`", READ_BY_OTHERS.read_text(encoding="utf-8"))
    assert topic in seen


def test_a_subscription_that_the_server_does_not_serve_is_found() -> None:
    assert not levels_match("plant/+/+", "plant/Fleet/press/position.x")
    assert not levels_match("site/+/+/+", "plant/Fleet/press/position.x")
    assert dict(named("_/_/robot/_", "plant/Fleet/press/position.x")) == {"robot": "press"}
