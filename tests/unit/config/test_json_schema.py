"""The schema for editors says what the loader does, as far as a schema can."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from ua_demo.pal.setting import fleet_text

from tests.unit.demo.test_talkrobots_setting import made, site
from tests.unit.docs.pages import ROOT, Block, blocks
from ua_fleet.config.default_file import default_content
from ua_fleet.config.json_schema import SCHEMA_FILE, fleet_schema, schema_text
from ua_fleet.config.load import load_content
from ua_fleet.document import read_document
from ua_fleet.errors import ConfigInvalid

COMMITTED = ROOT / "docs" / "schemas" / "fleet.schema.json"


@pytest.fixture(scope="module")
def editor() -> Any:
    return Draft202012Validator(json.loads(COMMITTED.read_text(encoding="utf-8")))


def said(editor: Any, text: str) -> list[str]:
    """What an editor finds wrong with a file that is YAML as we read it."""
    document = read_document(text.encode(), "f.yaml")
    assert [str(problem) for problem in document.problems] == []
    return [f"{error.json_path}: {error.message}"[:200] for error in editor.iter_errors(document.data)]


def refused(text: str) -> bool:
    try:
        load_content(text.encode(), "f.yaml", {"NAME": "1"}, allow_missing_ids=True)
    except ConfigInvalid:
        return True
    return False


def test_the_committed_schema_is_that_of_the_models() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == schema_text(fleet_schema()), (
        f"run: ua-fleet config schema -o docs/schemas/{SCHEMA_FILE}"
    )


def test_it_is_a_schema() -> None:
    Draft202012Validator.check_schema(fleet_schema())


def test_every_key_has_a_text() -> None:
    schema = fleet_schema()
    definitions: dict[str, Any] = schema["$defs"]

    def text_of(shape: dict[str, Any]) -> str:
        inner = [shape, *shape.get("anyOf", [])]
        names = [part["$ref"].rpartition("/")[2] for part in inner if "$ref" in part]
        return shape.get("description") or next((definitions[name].get("description", "") for name in names), "")

    bare = {
        f"{name}.{key}"
        for name, definition in {"": schema, **definitions}.items()
        for key, shape in definition.get("properties", {}).items()
        if not text_of(shape)
    }
    assert bare == set()


@pytest.mark.parametrize("block", [pytest.param(block, id=block.place) for block in blocks("yaml")])
def test_examples_of_the_documentation(block: Block, editor: Any) -> None:
    assert said(editor, block.text) == []


@pytest.mark.parametrize("secure", [True, False])
@pytest.mark.parametrize("ros1", [True, False])
def test_the_demonstrations(secure: bool, ros1: bool, tmp_path: Path, editor: Any) -> None:
    made(tmp_path, ros1=ros1, secure=secure)
    layout = site(tmp_path, ros1=ros1, secure=secure).layout("pal")
    nine_tasks = (tmp_path / "fleet.yaml").read_text(encoding="utf-8")
    line = fleet_text(layout, arm_space=1 if ros1 else 22, mobile_space=21)
    assert said(editor, nine_tasks) == []
    assert said(editor, line) == []


def test_the_file_to_start_from(editor: Any) -> None:
    text = default_content().decode()
    assert text.startswith(f"# yaml-language-server: $schema={SCHEMA_FILE}\n")
    assert said(editor, text) == ["$.pubsub: 'security' is a required property"]


def test_the_file_to_start_from_with_all_that_it_shows(editor: Any) -> None:
    text = default_content().decode().replace("#security: none", "").replace("#security: sign\n", "\n")
    text = re.sub(r": \{\}\n(?=\s+#[a-z])", ":\n", text)
    text = re.sub(r"^( *)#(?=[a-z]|  )", r"\1", text, flags=re.MULTILINE)
    assert len(read_document(text.encode(), "f").data["bridges"]) == 6
    assert said(editor, text) == []


HEAD = "version: 1\npubsub: {security: none}\n"
CELL = HEAD + "bridges: {a: {kind: ros1}, hall: {kind: modbus, space: 300, devices: {d: {host: h}}}}\nrobots:\n"
DATA = CELL + "  r:\n    bridge: a\n    data: {x: {%s}}\n"
REGISTER = CELL + "  r:\n    bridge: hall\n    data: {x: {type: Double, source: {at: {%s}}}}\n"
PLUGGED = HEAD + "bridges:\n  a:\n    kind: plugged\n    space: 300\n    devices: {d: {%s}}\n"
UR = HEAD + "bridges: {a: {kind: ur, space: 300, address: h}}\nrobots:\n  r: {bridge: a, skills: {s: {via: {%s}}}}\n"
TCP = HEAD + "bridges: {a: {kind: tcp, space: 300, %s}}\n"

RIGHT = [
    HEAD,
    HEAD + "fleet:\nserver:\nbridges:\nrobots:\nresilience:\n",
    HEAD + "server: {port: '${NAME}'}\n",
    HEAD.replace("none", "'${MODE}'"),
    HEAD + "server: {unknown_sources: create, analog_rate_hz: 5}\n",
    HEAD + "resilience: {criteria: , faults: }\n",
    CELL + "  r: {bridge: a, data: , skills: {go: }}\n",
    DATA % "type: Double, range: [0, 1.5], unit: m",
    DATA % "type: Double, source: {topic: /x, type: std_msgs/Float64}",
    DATA % "fields: {a: {type: Boolean}}, unit: ''",
    DATA % "id: 7, type: String, origin: server, initial: text",
    REGISTER % "table: holding, address: 3, type: int16, scale: 0.1",
    PLUGGED % "match: {vendor: '2341'}",
    PLUGGED % "path: /dev/video0, port: {baud: 9600}",
    UR % "stop: {}",
    TCP % "direct: {connect: '10.0.0.7:30002'}",
    TCP % "interpreter: {listen: '0.0.0.0:4000', peer: 10.0.0.7}",
    HEAD + "modbus: {commands: {go: {code: 1, scenario: shift}}}\n",
    HEAD + "history: {days: 7, megabytes: 50, record: false}\n",
    DATA % "type: Double, history: {deadband: 0.5}" + "history:\n",
]
WRONG = [
    "pubsub: {security: none}\n",
    HEAD.replace("1", '"1"'),
    HEAD.replace("1", "2"),
    HEAD.replace("none", "some"),
    "version: 1\npubsub:\n",
    HEAD + "robot: {}\n",
    HEAD + "server: {prot: 1}\n",
    HEAD + "server: {port: 70000}\n",
    HEAD + "server: {port: x}\n",
    HEAD + "server: {port: 1.5}\n",
    HEAD + "server: {port: }\n",
    HEAD + "server: {host: 1}\n",
    HEAD + "server: {path: 'a b'}\n",
    HEAD + "scenarios:\n",
    HEAD + "bridges: {9a: {kind: ros1}}\n",
    HEAD + "bridges: {a: }\n",
    HEAD + "bridges: {a: {kind: ros3}}\n",
    HEAD + "bridges: {a: {kind: ros1, space: 2}}\n",
    HEAD + "bridges: {a: {kind: ros1, discovery: subnet}}\n",
    HEAD + "bridges: {a: {kind: ros2, space: 233}}\n",
    HEAD + "bridges: {a: {kind: ros2}}\n",
    HEAD + "bridges: {a: {kind: ur, space: 2, address: h}}\n",
    HEAD + "bridges: {a: {kind: modbus, space: 300, devices: {}}}\n",
    HEAD + "bridges: {a: {kind: modbus, space: 300, devices: {d: {host: h, serial: {tty: /dev/x}}}}}\n",
    HEAD + "bridges: {a: {kind: modbus, space: 300, devices: {d: {host: h, tls: {ca: a, key: b}}}}}\n",
    CELL + "  r: {}\n",
    DATA % "id: , type: Double",
    DATA % "id: 0, type: Double",
    DATA % "type: Dubel",
    DATA % "unit: m",
    DATA % "type: Double, fields: {a: {type: Double}}",
    DATA % "fields: {a: {type: Double}}, unit: m",
    DATA % "type: String, range: [0, 1]",
    DATA % "type: Double, range: [0]",
    DATA % "type: Double, origin: server, gives: [fly]",
    DATA % "type: Double, origin: server, source: {topic: /x, type: std_msgs/Float64}",
    DATA % "type: Double, source: {topic: /x}",
    DATA % "type: Double, source: {topic: /x, type: std_msgs/Float64, rate: 1}",
    REGISTER % "table: coil, address: 3, type: int16",
    REGISTER % "table: holding, address: 3, type: bool",
    REGISTER % "table: holding, address: 3, type: string",
    REGISTER % "table: holding, address: 3, type: int16, scale: 0",
    REGISTER % "table: tape, address: 3",
    CELL + "  r: {bridge: a, skills: {s: {arguments: {x: {type: DateTime}}}}}\n",
    CELL + "  r: {bridge: a, skills: {s: {via: {fly: {}}}}}\n",
    PLUGGED % "match: {subsystem: tty}",
    PLUGGED % "match: {vendor: '2341'}, path: /dev/x",
    UR % "stop: {}, script: {body: x}",
    UR % "set: {output: laser, value: 1}",
    TCP % "description: x",
    TCP % "interpreter: {listen: '0.0.0.0:4000'}",
    TCP % "direct: {connect: nowhere}",
    HEAD + "modbus: {commands: {go: {code: 1}}}\n",
    HEAD + "modbus: {commands: {go: {code: 1, scenario: shift, robot: r}}}\n",
    HEAD + "resilience: {criteria: {}}\n",
    HEAD + "resilience: {criteria: {c: {kind: cost, range: [0, 1]}}}\n",
    HEAD + "resilience: {criteria: {c: {kind: cost, range: [0, 1], value: a.b, tasks_ahead: true}}}\n",
]


@pytest.mark.parametrize("text", RIGHT)
def test_what_editors_take(text: str, editor: Any) -> None:
    assert said(editor, text) == []


@pytest.mark.parametrize("text", WRONG)
def test_what_editors_and_the_loader_refuse(text: str, editor: Any) -> None:
    assert said(editor, text)
    assert refused(text)


def test_a_fleet_of_the_schema_comes_from_the_folder_of_the_file(tmp_path: Path) -> None:
    from ua_fleet.config.default_file import write_schema

    assert write_schema(tmp_path) == tmp_path / SCHEMA_FILE
    assert (tmp_path / SCHEMA_FILE).read_text(encoding="utf-8") == COMMITTED.read_text(encoding="utf-8")
