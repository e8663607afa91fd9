from __future__ import annotations

from typing import Any

import pytest
import yaml
from ua_bridges.ur.sinks import sinks_of, speeds_of

from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ConfigInvalid
from ua_fleet.topics import Topic

FLEET = """
version: 1
pubsub: {security: none}
bridges:
  arm:
    kind: ur
    space: 300
    status_id: 1
    address: 192.168.0.10
    mirrors: {rover.temperature: {output: 'input_double_register[18]'}}
  cell: {kind: ur, space: 301, status_id: 90, address: 192.168.0.11, first_register: 12}
robots:
  rover:
    bridge: cell
    data:
      temperature: {id: 91, type: Double, path: actual_main_voltage, source: {}}
      torques: {id: 92, type: Double, array: true, path: target_moment, source: {}}
      modes: {id: 93, fields: {robot_mode: {type: Int32}, safety_mode: {type: Int32}}, source: {}}
      wanted: {id: 94, type: Double, origin: server, sink: {output: speed_slider}}
  ur5:
    bridge: arm
    skill_status_id: 2
    fault_id: 3
    data:
      joints: {id: 11, type: Double, array: true, path: actual_q, source: {max_rate_hz: 125}}
      shoulder: {id: 12, type: Double, path: 'actual_q[1]', source: {}}
      state:
        id: 13
        fields: {robot_mode: {type: Int32}, mode: {type: String, path: robot_mode_text}}
        source: {only_changes: true}
      input: {id: 14, type: Boolean, path: 'actual_digital_input_bits[3]', source: {}}
      slider: {id: 15, type: Double, origin: server, sink: {output: speed_slider}}
    skills:
      turn:
        id: 21
        arguments: {base: {type: Double}, speed: {type: Float, default: 1.0}}
        via: {move_j: {joints: [base, -1.57, 0, -1.57, 0, 0], speed: speed}}
      lower:
        id: 22
        arguments: {z: {type: Double}}
        via: {move_l: {pose: [0.4, 0.1, z, 3.14, 0, 0]}}
      measure:
        id: 23
        arguments: {text: {type: String}}
        results: {force: {type: Double}, count: {type: Int32}}
        via:
          script:
            body: 'textmsg({text})'
            results: {force: {place: 12}, count: {register_type: int, place: 13}}
      load: {id: 24, arguments: {program: {type: String}}, via: {dashboard: {command: load, text: program}}}
      play: {id: 25, via: {dashboard: {command: play, wait_for_end: true}}}
      grip: {id: 26, arguments: {close: {type: Boolean}}, via: {set: {output: 'tool_digital_out[0]', value: close}}}
      slow: {id: 27, via: {set: {output: speed_slider, value: 0.2}}}
      stop: {id: 28, via: {stop: {deceleration: 4}}}
"""


def changed(path: str, value: Any) -> str:
    document = yaml.safe_load(FLEET)
    at = document
    *steps, last = path.split("/")
    for step in steps:
        at = at[step]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return yaml.safe_dump(document)


def load(text: str) -> FleetConfig:
    return load_content(text.encode(), "fleet.yaml", {})


def test_example_is_valid() -> None:
    load(FLEET)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("bridges/arm/space", 3, "256 to 65535"),
        ("bridges/arm/address", "192.168.0.10:30004", "address"),
        ("bridges/arm/retry_s", [2, 1], "retry_s"),
        ("robots/ur5/data/joints/path", "actual_w", "no variable `actual_w`"),
        ("robots/ur5/data/joints/path", "actual_q[6]", "no variable `actual_q[6]`"),
        ("robots/ur5/data/joints/path", None, "no variable `(none)`"),
        ("robots/ur5/data/joints/array", False, "has several values"),
        ("robots/ur5/data/shoulder/array", True, "has one value"),
        ("robots/ur5/data/joints/type", "Int32", "is no Int32"),
        ("robots/ur5/data/input/type", "UInt32", "is no UInt32"),
        ("robots/ur5/data/joints/source", None, "no `source`"),
        ("robots/ur5/data/joints/source/max_rate_hz", 501, "max_rate_hz"),
        ("robots/ur5/data/slider/sink", None, "no `sink`"),
        ("robots/ur5/data/slider/sink/output", "standard_digital_out[8]", "no output"),
        ("robots/ur5/data/slider/sink/output", "speed_slider[0]", "no output"),
        ("robots/ur5/data/slider/type", "Boolean", "takes no Boolean"),
        ("robots/ur5/skills/turn/via", None, "no `via`"),
        ("robots/ur5/skills/turn/via/stop", {}, "exactly one"),
        ("robots/ur5/skills/turn/via/move_j/joints", ["base", 0, 0, 0, 0], "joints"),
        ("robots/ur5/skills/turn/via/move_j/speed", "sped", "no argument `sped`"),
        ("robots/ur5/skills/turn/via/move_j/speed", 1.0, "goes nowhere"),
        ("robots/ur5/skills/turn/arguments/base/type", "String", "is a String"),
        ("robots/ur5/skills/turn/results", {"x": {"type": "Double"}}, "nothing brings this result"),
        ("robots/ur5/skills/measure/via/script/body", "textmsg({txt})", "no argument"),
        ("robots/ur5/skills/measure/via/script/body", "textmsg(1)", "stands nowhere"),
        ("robots/ur5/skills/measure/via/script/body", "textmsg({text})}", "Single '}'"),
        ("robots/ur5/skills/measure/via/script/results/count/place", 18, "the bridge's own"),
        ("robots/ur5/skills/measure/via/script/results/count/place", 11, "place"),
        ("robots/ur5/skills/measure/results/force/type", "String", "holds no String"),
        ("robots/ur5/skills/load/via/dashboard/text", None, "needs a text"),
        ("robots/ur5/skills/play/via/dashboard/text", "program", "takes no text"),
        ("robots/ur5/skills/play/via/dashboard/command", "stop", "has no end"),
        ("robots/ur5/skills/play/via/dashboard/command", "fly", "command"),
        ("robots/ur5/skills/play/via/dashboard/end_register", 18, "the bridge's own"),
        ("robots/ur5/skills/play/via/dashboard/end_register", 11, "end_register"),
        ("robots/ur5/skills/load/via/dashboard/end_register", 13, "nobody waits for the end"),
        ("robots/ur5/skills/slow/via/set/value", 2.0, "not within 0 to 1"),
        ("robots/ur5/skills/grip/arguments/close/type", "Double", "is a Double"),
        ("robots/other", {"bridge": "arm"}, "has a robot already"),
        ("bridges/arm/mirrors", {"rover.temperatur": {"output": "speed_slider"}}, "there is no data"),
        ("bridges/arm/mirrors", {"rover.torques": {"output": "speed_slider"}}, "takes no array of Double"),
        ("bridges/arm/mirrors", {"rover.modes": {"output": "speed_slider"}}, "takes one value, and not 2"),
        ("bridges/arm/mirrors", {"rover.temperature": {"output": "tool_digital_out[0]"}}, "takes no Double"),
        ("bridges/arm/mirrors", {"ur5.slider": {"output": "speed_slider"}}, "own robot"),
        ("bridges/arm/mirrors", {"rover.temperature": {"output": "speed"}}, "no output"),
    ],
)
def test_mistake_is_told_with_its_line(path: str, value: Any, said: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        load(changed(path, value))
    lines = [str(problem) for problem in caught.value.problems]
    assert any(said in line for line in lines), lines
    assert all(problem.line > 0 for problem in caught.value.problems)


def test_own_data_and_that_of_other_spaces_have_outputs() -> None:
    text = changed("bridges/arm/mirrors/rover.wanted", {"output": "input_double_register[19]"})
    found = {topic.name: (output.name, output.place) for topic, (_, output) in sinks_of(load(text), "arm").items()}
    assert found == {
        "ua_0_2_15": ("speed_slider", None),
        "ua_301_2_91": ("input_double_register", 18),
        "ua_0_2_94": ("input_double_register", 19),
    }


DRIVEN = """
version: 1
pubsub: {security: none}
bridges:
  cell: {kind: ur, space: 301, status_id: 1001, address: 192.168.0.11}
robots:
  arm:
    bridge: cell
    data:
      jog:
        id: 1002
        origin: server
        fields: {x: {type: Double}, turn: {type: Double, path: rz}}
        sink: {output: tool_speed}
    teleoperation:
      id: 1003
      acquire_id: 1004
      renew_id: 1005
      release_id: 1006
      data: jog
      axes:
        x: {speed: 0.1, acceleration: 0.5, jerk: 5}
        turn: {speed: 0.2, acceleration: 1, jerk: 10}
      robot_timeout_ms: 300
"""


def test_an_arm_is_driven_by_the_speed_of_its_tool() -> None:
    config = load(DRIVEN)
    assert list(speeds_of(config, "cell")) == [Topic(0, 2, 1002)]
    assert sinks_of(config, "cell") == {}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("x: {type: Double}", "x: {type: Double, path: base}", "`tool_speed` has no axis `base`; there are: `x`"),
        ("path: rz}", "path: x}", "another field is the axis `x` already"),
        ("output: tool_speed", "output: speed_slider", "nobody drives an arm by `speed_slider`"),
        ("output: tool_speed", "output: tool_sped", "there is no output `tool_sped`"),
        (
            DRIVEN[DRIVEN.index("    teleoperation") :],
            "",
            "`tool_speed` is written by teleoperation alone; name this data",
        ),
    ],
)
def test_a_mistake_in_what_drives_an_arm(old: str, new: str, said: str) -> None:
    assert old in DRIVEN
    with pytest.raises(ConfigInvalid) as caught:
        load(DRIVEN.replace(old, new, 1))
    assert [problem for problem in caught.value.problems if said in str(problem)], str(caught.value)
