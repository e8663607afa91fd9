"""What is in force is shown so that it could be loaded again, and no secret with it."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.unit.config.test_json_schema import RIGHT
from tests.unit.docs.pages import blocks
from ua_fleet.config.default_file import default_content
from ua_fleet.config.load import load_content, load_document
from ua_fleet.config.show import as_tree, as_yaml, nearest_key, settings

FLEET = """\
version: 1
pubsub:
  security: ${MODE}
  relaxed_replay:
    - 3
    - ${SPACE}
server:
  port: 4900
bridges:
  cell: {kind: ros1, status_id: 1}
  pc: {kind: plugged, space: 300, status_id: 2, devices: {cam: {path: /dev/video0}}}
robots:
  ned:
    bridge: cell
    skill_status_id: 5
    data:
      belt: {id: 3, type: Boolean, description: "1e5 $${x}"}
    skills:
      go: {id: 4, via: {topic: {topic: /go, type: std_msgs/Bool}}}
  pc:
    bridge: pc
    data:
      view: {id: 6, type: String, source: {device: cam, url: "rtsp://anna:hush@cam/1"}}
      code: {id: 7, type: String, source: {device: cam, url: "http://cam/${TOKEN}"}}
"""
ENVIRONMENT = {
    "MODE": "none",
    "SPACE": "2",
    "TOKEN": "hush",
    "UA_FLEET__SERVER__HOST": "0.0.0.0",
    "UA_FLEET__BRIDGES__CELL__NODE_NAME": "b",
}


def shown(text: str = FLEET, environment: dict[str, str] = ENVIRONMENT) -> dict[str, tuple[Any, str]]:
    """Value and origin by key."""
    config, document = load_document(text.encode(), "f.yaml", environment)
    return {setting.key: (setting.value, setting.origin) for setting in settings(config, document)}


def fleet_of(text: str) -> str:
    return text.replace("${MODE}", "none").replace("${SPACE}", "2")


def test_each_value_with_where_it_comes_from() -> None:
    found = shown()
    assert found["version"] == (1, "f.yaml:1")
    assert found["server.port"] == (4900, "f.yaml:8")
    assert found["server.host"] == ("0.0.0.0", "UA_FLEET__SERVER__HOST")
    assert found["server.path"] == ("ua_fleet", "default")
    assert found["bridges.cell.node_name"] == ("b", "UA_FLEET__BRIDGES__CELL__NODE_NAME")
    assert found["bridges.cell.master_uri"] == ("http://127.0.0.1:11311", "default")
    assert found["robots.ned.skills.go.via.topic.type"] == ("std_msgs/Bool", "f.yaml:19")
    assert found["robots.ned.skills.go.via.topic.qos.depth"] == (10, "default")
    assert found["robots.ned.data.belt.description"] == ("1e5 ${x}", "f.yaml:17")


def test_what_comes_from_variables_and_users_in_urls_are_hidden() -> None:
    found = shown()
    assert found["pubsub.security"] == ("${MODE}", "f.yaml:3")
    assert found["pubsub.relaxed_replay"] == ([3, "${SPACE}"], "f.yaml:4")
    assert found["robots.pc.data.view.source.url"] == ("rtsp://***@cam/1", "f.yaml:23")
    assert found["robots.pc.data.code.source.url"] == ("http://cam/${TOKEN}", "f.yaml:24")
    assert "hush" not in str(found)


def test_the_environment_takes_the_place_of_a_variable_too() -> None:
    text = "version: 1\npubsub: {security: '${MODE}'}\n"
    found = shown(text, {"MODE": "sign", "UA_FLEET__PUBSUB__SECURITY": "none"})
    assert found["pubsub.security"] == ("none", "UA_FLEET__PUBSUB__SECURITY")


EXAMPLES = [*(block.text for block in blocks("yaml")), *(text for text in RIGHT if "NAME" not in text)]


@pytest.mark.parametrize("text", EXAMPLES)
def test_what_is_shown_is_the_same_configuration(text: str) -> None:
    environment = {"MODE": "none"}
    config, document = load_document(text.encode(), "f.yaml", environment, allow_missing_ids=True)
    printed = as_yaml(settings(config, document), list(document.variables.values()))
    again, its_document = load_document(printed.encode(), "shown.yaml", environment, allow_missing_ids=True)
    assert again.model_copy(update={"robots": {}}) == config.model_copy(update={"robots": {}}), printed
    # `via` is kept as it is written, so there the defaults make a difference.
    values = [(one.key, one.value) for one in settings(config, document)]
    assert [(one.key, one.value) for one in settings(again, its_document)] == values


def test_what_is_shown_of_the_file_to_start_from_is_the_same_configuration() -> None:
    text = default_content().decode().replace("#security: none", "security: none")
    config, document = load_document(text.encode(), "f.yaml", {}, allow_missing_ids=True)
    printed = as_yaml(settings(config, document))
    assert load_content(printed.encode(), "shown.yaml", {}, allow_missing_ids=True) == config


@pytest.mark.parametrize(
    "text", ["on", "1e5", "0x10", "true", "", "~", "a: b", "# no", "${X} $${Y}", "2020-01-01", "é\n"]
)
def test_texts_stay_texts(text: str) -> None:
    written = text.replace("${", "$${").replace("\n", "\\n")
    fleet = f'version: 1\npubsub: {{security: none}}\nbridges: {{a: {{kind: ros1, description: "{written}"}}}}\n'
    config, document = load_document(fleet.encode(), "f.yaml", {}, allow_missing_ids=True)
    assert config.bridges["a"].description == text
    printed = as_yaml(settings(config, document))
    assert load_content(printed.encode(), "s.yaml", {}, allow_missing_ids=True).bridges["a"].description == text


def test_keys() -> None:
    config, document = load_document(fleet_of(FLEET).encode(), "f.yaml", {"TOKEN": "1"})
    found = settings(config, document)
    assert as_tree([one for one in found if one.is_below("server.port")]) == {"server": {"port": 4900}}
    assert next(one.key for one in found if one.is_below("robots.ned.data")) == "robots.ned.data.belt.id"
    assert not any(one.is_below("serv") for one in found)
    assert nearest_key("server.prot", found) == "did you mean `server.port`?"
    assert not re.search(r"&|\*id", as_yaml(found))
