from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.config import load
from ua_fleet.config.parts import Parts
from ua_fleet.config.schema import FleetConfig, UnknownSources
from ua_fleet.errors import ConfigInvalid

load_module: Any = importlib.import_module("ua_fleet.config.load")  # the package has a function of that name

HEAD = "version: 1\npubsub: {security: none}\n"
BRIDGES = HEAD + "bridges:\n  cell: {kind: ros1, status_id: 1}\n  floor: {kind: ros2, space: 2, status_id: 2}\n"
ROBOT = BRIDGES + "robots:\n  ned:\n    bridge: cell\n    data:\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def problems(
    folder: Path, text: str, environment: Mapping[str, str] | None = None, options: Mapping[str, object] | None = None
) -> list[str]:
    path = write(folder, text)
    with pytest.raises(ConfigInvalid) as caught:
        load(path, environment or {}, overrides=options)
    found = [str(problem).replace(str(path), "F") for problem in caught.value.problems]
    assert not any("\n" in line for line in found)
    return found


def accepted(folder: Path, text: str, environment: Mapping[str, str] | None = None) -> FleetConfig:
    return load(write(folder, text), environment or {})


KINDS = ", ".join([f"`{name}`" for name in sorted(entry_points(group="ua_fleet.bridges").names)])
SECURITIES = "`none`, `sign`, `sign_and_encrypt`, `broker`"
NO_SECURITY = f"`security` is missing; add `security: sign_and_encrypt`; allowed: {SECURITIES}"
PUSHED_BY = (
    "F:4:pubsub.keys.pushed_by: goes with `source: pushed`, which needs it; name a user that `ua-fleet user add` made"
)
SECURED = "version: 1\npubsub:\n  security: sign_and_encrypt\n"

BAD: list[tuple[str, str, list[str]]] = [
    # --- the file and its sections
    ("no version", "pubsub: {security: none}\n", ["F:version: `version` is missing; add `version: 1`"]),
    (
        "version is a text",
        HEAD.replace("1", '"1"'),
        ["F:1:version: `1` is not allowed; remove the quotes; allowed: `1`"],
    ),
    ("version without value", HEAD.replace(" 1", ""), ["F:1:version: `nothing` is not allowed; allowed: `1`"]),
    ("no pubsub", "version: 1\n", [f"F:pubsub.security: {NO_SECURITY}"]),
    ("pubsub empty", "version: 1\npubsub:\n", [f"F:2:pubsub.security: {NO_SECURITY}"]),
    ("a section that is a text", HEAD + "server: x\n", ["F:3:server: must have keys with values"]),
    ("unknown section", HEAD + "robot: {}\n", ["F:3:robot: unknown key `robot`; did you mean `robots`?"]),
    ("key at the wrong level", HEAD + "port: 1\n", ["F:3:port: unknown key `port`; it belongs under `server`"]),
    # --- server
    ("unknown key", HEAD + "server:\n  prot: 1\n", ["F:4:server.prot: unknown key `prot`; did you mean `port`?"]),
    (
        "a key like no other",
        HEAD + "fleet:\n  zzzz: 1\n",
        [
            (
                "F:4:fleet.zzzz: unknown key `zzzz`; known keys: "
                "`name`, `namespace_uri`, `namespace_index`, `namespaces`, `places`"
            )
        ],
    ),
    ("too large", HEAD + "server:\n  port: 70000\n", ["F:4:server.port: must be at most 65535, not 70000"]),
    ("negative", HEAD + "server:\n  port: -1\n", ["F:4:server.port: must be at least 0, not -1"]),
    ("not a number", HEAD + "server:\n  port: x\n", ["F:4:server.port: must be a whole number, not `x`"]),
    (
        "a number in quotes",
        HEAD + 'server:\n  port: "4840"\n',
        ["F:4:server.port: must be a whole number, not `4840`; remove the quotes"],
    ),
    ("a fraction", HEAD + "server:\n  port: 1.5\n", ["F:4:server.port: must be a whole number, not `1.5`"]),
    ("a huge number", HEAD + "server:\n  port: 1e400\n", ["F:4:server.port: must be a whole number, not `inf`"]),
    (
        "no value",
        HEAD + "server:\n  port:\n",
        ["F:4:server.port: has no value; it must be a whole number; write a value, or remove the key"],
    ),
    ("a list", HEAD + "server:\n  port: [1]\n", ["F:4:server.port: must be a whole number, not a list"]),
    ("keys", HEAD + "server:\n  port: {a: 1}\n", ["F:4:server.port: must be a whole number, not keys with values"]),
    (
        "yes is not true",
        HEAD + "server:\n  allow_anonymous: yes\n",
        ["F:4:server.allow_anonymous: must be true or false, not `yes`"],
    ),
    (
        "a text that is a number",
        HEAD + "server:\n  state_dir: 12\n",
        ['F:4:server.state_dir: must be a text, not 12; put it in quotes: "12"'],
    ),
    (
        "one of several",
        HEAD + "server:\n  unknown_sources: creat\n",
        [
            (
                "F:4:server.unknown_sources: `creat` is not allowed; "
                "did you mean `create`? allowed: `create`, `quarantine`, `ignore`"
            )
        ],
    ),
    (
        "zero rate",
        HEAD + "server:\n  analog_rate_hz: 0\n",
        ["F:4:server.analog_rate_hz: must be greater than 0, not 0"],
    ),
    (
        "pattern without example",
        HEAD + "server:\n  path: a b\n",
        ["F:4:server.path: `a b` is not in the right form; write it like `ua_fleet`"],
    ),
    (
        "a fleet name",
        HEAD + "fleet: {name: 1st}\n",
        ["F:3:fleet.name: `1st` is not in the right form; write it like `Fleet`"],
    ),
    (
        "short URI",
        HEAD + "fleet: {namespace_uri: x}\n",
        ["F:3:fleet.namespace_uri: is too short; it needs 3 characters"],
    ),
    (
        "the namespace's index",
        HEAD + "fleet: {namespace_index: 3}\n",
        ["F:3:fleet.namespace_index: `3` is not allowed; allowed: `2`"],
    ),
    # --- pubsub
    (
        "security",
        "version: 1\npubsub:\n  security: SignAndEncrypt\n",
        [
            (
                "F:3:pubsub.security: `SignAndEncrypt` is not allowed; did you mean `sign_and_encrypt`? "
                f"allowed: {SECURITIES}"
            )
        ],
    ),
    (
        "security is no switch",
        "version: 1\npubsub:\n  security: on\n",
        [f"F:3:pubsub.security: `on` is not allowed; allowed: {SECURITIES}"],
    ),
    (
        "source of keys",
        SECURED + "  keys: {source: file}\n",
        ["F:4:pubsub.keys.source: `file` is not allowed; did you mean `files`? allowed: `service`, `files`, `pushed`"],
    ),
    (
        "policy of keys",
        SECURED + "  keys: {policy: Aes256}\n",
        [
            "F:4:pubsub.keys.policy: `Aes256` is not allowed; allowed: `PubSub-Aes256-CTR`, `PubSub-Aes128-CTR`",
        ],
    ),
    (
        "a key service for key files",
        SECURED + '  keys: {source: files, endpoint: "opc.tcp://a:1"}\n',
        ["F:4:pubsub.keys.endpoint: key files come from no service; remove it, or write `source: service`"],
    ),
    (
        "pushed keys without a user",
        SECURED + "  keys: {source: pushed}\n",
        [PUSHED_BY],
    ),
    (
        "a user without pushed keys",
        SECURED + "  keys: {pushed_by: sks}\n",
        [PUSHED_BY],
    ),
    (
        "keys too short-lived",
        SECURED + "  keys: {lifetime_s: 1}\n",
        ["F:4:pubsub.keys.lifetime_s: must be at least 2, since keys are fetched at half of it"],
    ),
    (
        "replays of no space",
        SECURED + "  relaxed_replay: [7, 240, 7]\n",
        [
            "F:4:pubsub.relaxed_replay[1]: space ids 233..255 are reserved",
            "F:4:pubsub.relaxed_replay[2]: 7 is named twice; remove one of them",
        ],
    ),
    (
        "more requestors than there is room for against replay",
        SECURED + f"bridges:\n  a: {{kind: ros2, space: 99, status_id: 1, requestors: {list(range(64))}}}\n",
        [
            (
                "F:5:bridges.a.requestors: 64 spaces may command it; commands of 63 are told from replayed ones; "
                "name fewer, or distribute its robots over several bridges"
            )
        ],
    ),
    (
        "requestors of no space",
        HEAD + "bridges:\n  a: {kind: ros2, space: 2, status_id: 1, requestors: [0, 233]}\n",
        ["F:4:bridges.a.requestors[1]: space ids 233..255 are reserved"],
    ),
    (
        "url",
        "version: 1\npubsub:\n  security: none\n  url: udp://x\n",
        ["F:4:pubsub.url: `udp://x` is not in the right form; write it like `opc.udp://224.0.2.14:4840`"],
    ),
    (
        "port of the url",
        "version: 1\npubsub:\n  security: none\n  url: opc.udp://224.0.2.14:0\n",
        ["F:4:pubsub.url: a port is 1 to 65535; the registered one is 4840"],
    ),
    (
        "timeouts",
        "version: 1\npubsub:\n  security: none\n  keep_alive_s: 5\n",
        ["F:2:pubsub: receive_timeout_s must be greater than keep_alive_s"],
    ),
    (
        "broken subnet",
        "version: 1\npubsub:\n  security: none\n  interface: 10.0.0.7/24\n",
        ["F:4:pubsub.interface: '10.0.0.7/24' is no subnet such as 192.168.1.0/24: 10.0.0.7/24 has host bits set"],
    ),
    # --- bridges
    (
        "no kind",
        HEAD + "bridges:\n  a: {status_id: 1}\n",
        [f"F:4:bridges.a.kind: `kind` is missing; there are: {KINDS}"],
    ),
    (
        "unknown kind",
        HEAD + "bridges:\n  a:\n    status_id: 1\n    kind: rso2\n",
        [f"F:6:bridges.a.kind: no bridge of kind `rso2` is installed; did you mean `ros2`? there are: {KINDS}"],
    ),
    (
        "a kind that is a number",
        HEAD + "bridges:\n  a: {status_id: 1, kind: 7}\n",
        [f"F:4:bridges.a.kind: no bridge of kind `7` is installed; there are: {KINDS}"],
    ),
    (
        "a key of another kind",
        HEAD + "bridges:\n  a: {kind: ros2, space: 2, status_id: 1, master_uri: x}\n",
        [
            (
                "F:4:bridges.a.master_uri: unknown key `master_uri`; known keys: "
                "`kind`, `space`, `status_id`, `description`, `publisher_id`, `publisher_id_type`, `state_dir`, "
                "`connections`, `requestors`, `monitoring_port`, "
                "`node_name`, `discovery`"
            )
        ],
    ),
    (
        "ROS 1 elsewhere",
        HEAD + "bridges:\n  a: {kind: ros1, space: 2, status_id: 1}\n",
        ["F:4:bridges.a.space: `2` is not allowed; allowed: `1`"],
    ),
    (
        "no space",
        HEAD + "bridges:\n  a: {kind: ros2, status_id: 1}\n",
        ["F:4:bridges.a.space: `space` is missing; add `space: ...`"],
    ),
    (
        "domain 233",
        HEAD + "bridges:\n  a: {kind: ros2, space: 233, status_id: 1}\n",
        ["F:4:bridges.a.space: space ids 233..255 are reserved"],
    ),
    (
        "the server's space",
        HEAD + "bridges:\n  a: {kind: ros2, space: 0, status_id: 1}\n",
        ["F:4:bridges.a.space: space 0 is the server's own"],
    ),
    (
        "a vendor's space for ROS 2",
        HEAD + "bridges:\n  a: {kind: ros2, space: 300, status_id: 1}\n",
        ["F:4:bridges.a.space: a ROS 2 space is the domain id, 2..232"],
    ),
    (
        "two in a space",
        BRIDGES + "  third: {kind: ros2, space: 2, status_id: 3}\n",
        [
            (
                "F:6:bridges.third.space: bridge `floor` stands in space 2 already, and two would forward "
                "everything twice; give this bridge another space, or remove it"
            )
        ],
    ),
    (
        "no status id",
        HEAD + "bridges:\n  a: {kind: ros1}\n",
        ["F:4:bridges.a.status_id: `status_id` is missing; run: ua-fleet config assign-ids F"],
    ),
    (
        "a bridge's name",
        HEAD + "bridges:\n  1a: {kind: ros1, status_id: 1}\n",
        [
            (
                "F:4:bridges.1a: `1a` is not allowed as a name; "
                "begin with a letter; then letters, digits, _ and -, 64 at most"
            )
        ],
    ),
    # --- robots
    (
        "no such bridge",
        BRIDGES + "robots:\n  ned: {bridge: cel}\n",
        ["F:7:robots.ned.bridge: there is no bridge `cel`; did you mean `cell`?"],
    ),
    (
        "no bridge like it",
        BRIDGES + "robots:\n  ned: {bridge: zzz}\n",
        ["F:7:robots.ned.bridge: there is no bridge `zzz`; there are: `cell`, `floor`"],
    ),
    (
        "no bridges",
        HEAD + "robots:\n  ned: {bridge: a}\n",
        ["F:4:robots.ned.bridge: there is no bridge `a`; add it under `bridges`"],
    ),
    (
        "bridge missing",
        BRIDGES + "robots:\n  ned:\n",
        ["F:7:robots.ned.bridge: `bridge` is missing; add `bridge: ...`"],
    ),
    (
        "capacities",
        BRIDGES + "robots:\n  ned: {bridge: cell, capacities: grab}\n",
        ["F:7:robots.ned.capacities: must be a list like [a, b], not `grab`"],
    ),
    (
        "one capacity",
        BRIDGES + "robots:\n  ned:\n    bridge: cell\n    capacities:\n    - grab\n    - 2\n",
        ['F:11:robots.ned.capacities[1]: must be a text, not 2; put it in quotes: "2"'],
    ),
    # --- data
    (
        "no type",
        ROBOT + "      q: {id: 5}\n",
        ["F:10:robots.ned.data.q: give `type` (one field) or `fields` (several)"],
    ),
    (
        "type and fields",
        ROBOT + "      q: {id: 5, type: Double, fields: {a: {type: Double}}}\n",
        ["F:10:robots.ned.data.q: give either `type` (one field) or `fields` (several), not both"],
    ),
    ("id 0", ROBOT + "      q: {id: 0, type: Double}\n", ["F:10:robots.ned.data.q.id: must be at least 1, not 0"]),
    (
        "id missing",
        ROBOT + "      q: {type: Double}\n",
        ["F:10:robots.ned.data.q.id: `id` is missing; run: ua-fleet config assign-ids F"],
    ),
    (
        "id without value",
        ROBOT + "      q: {id: , type: Double}\n",
        ["F:10:robots.ned.data.q.id: `id` has no value; remove it and run: ua-fleet config assign-ids F"],
    ),
    (
        "id used twice",
        ROBOT + "      q: {id: 5, type: Double}\n      r:\n        type: Double\n        id: 5\n",
        [
            (
                "F:13:robots.ned.data.r.id: 5 is in use already (robots.ned.data.q.id, line 10); "
                "remove it here and run: ua-fleet config assign-ids F"
            )
        ],
    ),
    (
        "id of a bridge's status",
        ROBOT + "      q: {id: 2, type: Double}\n",
        [
            (
                "F:10:robots.ned.data.q.id: 2 is in use already (bridges.floor.status_id, line 5); "
                "remove it here and run: ua-fleet config assign-ids F"
            )
        ],
    ),
    (
        "range backwards",
        ROBOT + "      q: {id: 5, type: Double, range: [1, 0]}\n",
        ["F:10:robots.ned.data.q: range: the first value must be less than the second"],
    ),
    (
        "range of three",
        ROBOT + "      q: {id: 5, type: Double, range: [1, 2, 3]}\n",
        ["F:10:robots.ned.data.q.range: must have 2 values, not 3"],
    ),
    (
        "range of a text",
        ROBOT + "      q: {id: 5, type: String, range: [0, 1]}\n",
        ["F:10:robots.ned.data.q: range: String has no range"],
    ),
    (
        "initial of a robot's value",
        ROBOT + "      q: {id: 5, type: Double, initial: 1}\n",
        [
            (
                "F:10:robots.ned.data.q.initial: is for data that clients write; "
                "remove it, or set `origin: server` for this data source"
            )
        ],
    ),
    (
        "initial is a list",
        ROBOT + "      q: {id: 5, type: Double, origin: server, initial: [1]}\n",
        ["F:10:robots.ned.data.q.initial: must be a single value: true or false, a number or a text"],
    ),
    (
        "path",
        ROBOT + "      q: {id: 5, type: Double, path: a..b}\n",
        ["F:10:robots.ned.data.q.path: `a..b` is not in the right form; write it like `twist.linear.x`"],
    ),
    (
        "sink of a robot's value",
        ROBOT + "      q: {id: 5, type: Double, sink: {topic: /a, type: std_msgs/Float64}}\n",
        ["F:10:robots.ned.data.q.sink: data of origin robot is read from the robot; a sink needs `origin: server`"],
    ),
    (
        "source of the server's value",
        ROBOT + "      q: {id: 5, type: Double, origin: server, source: {topic: /a, type: std_msgs/Float64}}\n",
        ["F:10:robots.ned.data.q.source: data of origin server has no source: clients write it"],
    ),
    (
        "topic and type",
        ROBOT
        + "      q:\n        id: 5\n        type: Double\n"
        + "        source:\n          topic: a b\n          type: Twist\n",
        [
            "F:14:robots.ned.data.q.source.topic: `a b` is not in the right form; write it like `/battery_state`",
            (
                "F:15:robots.ned.data.q.source.type: `Twist` is not in the right form; "
                "write it like `sensor_msgs/BatteryState`"
            ),
        ],
    ),
    (
        "a UA topic as a robot's own",
        ROBOT + "      q: {id: 5, type: Double, source: {topic: /ua_1_2_5, type: std_msgs/Float64}}\n",
        [
            (
                "F:10:robots.ned.data.q.source.topic: /ua_1_2_5 is a UA topic, which is bridged without "
                "being named here; remove `source`"
            )
        ],
    ),
    (
        "qos",
        ROBOT
        + "      q: {id: 5, type: Double, source: {topic: /a, type: std_msgs/Float64, qos: {reliability: best}}}\n",
        [
            (
                "F:10:robots.ned.data.q.source.qos.reliability: `best` is not allowed; "
                "did you mean `best_effort`? allowed: `reliable`, `best_effort`"
            )
        ],
    ),
    (
        "fields",
        ROBOT
        + "      q:\n        id: 5\n        fields:\n"
        + "          a: {tpye: Double}\n          b: Double\n          1c: {type: Byte}\n",
        [
            (
                "F:13:robots.ned.data.q.fields.a.type: `type` is missing; allowed: `Boolean`, `SByte`, `Byte`, "
                "`Int16`, `UInt16`, `Int32`, `UInt32`, `Int64`, `UInt64`, "
                "`Float`, `Double`, `String`, `DateTime`, `ByteString`"
            ),
            "F:13:robots.ned.data.q.fields.a.tpye: unknown key `tpye`; did you mean `type`?",
            "F:14:robots.ned.data.q.fields.b: must be keys with values, not `Double`",
            (
                "F:15:robots.ned.data.q.fields.1c: `1c` is not allowed as a name; "
                "a name begins with a letter; then letters, digits, _ and -, 64 at most"
            ),
        ],
    ),
    (
        "two that write one member of a topic",
        ROBOT
        + "      q: {id: 5, type: Double, origin: server, sink: {topic: /cmd, type: std_msgs/Float64}}\n"
        + "      r: {id: 6, type: Double, origin: server, sink: {topic: cmd, type: std_msgs/Float64}}\n",
        [
            (
                "F:11:robots.ned.data.r.sink.topic: data of /cmd is written by robots.ned.data.q already; "
                "give one of them another `path` or topic"
            )
        ],
    ),
    (
        "two types of one topic",
        ROBOT
        + "      q: {id: 5, type: Double, source: {topic: /a, type: std_msgs/Float64}}\n"
        + "      r: {id: 6, type: Double, source: {topic: /a, type: std_msgs/msg/Float64}}\n"
        + "      s: {id: 7, type: Double, source: {topic: a, type: std_msgs/Float32}}\n",
        [
            (
                "F:12:robots.ned.data.s.source.type: a has the type std_msgs/Float64 in robots.ned.data.q; "
                "a topic has one type; correct one of them"
            )
        ],
    ),
]


@pytest.mark.parametrize(("text", "expected"), [row[1:] for row in BAD], ids=[row[0] for row in BAD])
def test_each_mistake_is_said_with_its_line(text: str, expected: list[str], tmp_path: Path) -> None:
    assert problems(tmp_path, text) == expected


INITIAL: list[tuple[str, str, str]] = [
    ("Double", "1", ""),
    ("Double", "x", "must be a number for Double"),
    ("Double", "true", "must be a number for Double"),
    ("Float", "1e39", "does not fit into Float"),
    ("Byte", "255", ""),
    ("Byte", "256", "does not fit into Byte, 0 to 255"),
    ("SByte", "-129", "does not fit into SByte, -128 to 127"),
    ("UInt16", "-1", "does not fit into UInt16, 0 to 65535"),
    ("Int64", "9223372036854775807", ""),
    ("Int64", "9223372036854775808", "does not fit into Int64, -9223372036854775808 to 9223372036854775807"),
    ("UInt64", "18446744073709551615", ""),
    ("Int32", "1.0", "must be a whole number for Int32"),
    ("Boolean", "true", ""),
    ("Boolean", "1", "must be true or false for Boolean"),
    ("String", "abc", ""),
    ("String", "1", "must be a text for String, in quotes"),
    ("DateTime", "2030-01-31T12:00:00Z", ""),
    ("DateTime", "2030-01-31T12:00:00", "must be a time like 2030-01-31T12:00:00Z"),
    ("DateTime", "soon", "must be a time like 2030-01-31T12:00:00Z"),
    ("ByteString", "AA==", "a ByteString has no initial value"),
    ("Double, array: true", "1", "an array has no initial value"),
    ("'Double', range: [0, 5]", "5", ""),
    ("'Double', range: [0, 5]", "5.1", "is outside of the range 0 to 5"),
]


@pytest.mark.parametrize(("kind", "value", "message"), INITIAL)
def test_initial_values_fit_their_field(kind: str, value: str, message: str, tmp_path: Path) -> None:
    text = ROBOT + f"      q: {{id: 5, type: {kind}, origin: server, initial: {value}}}\n"
    if message:
        assert problems(tmp_path, text) == [f"F:10:robots.ned.data.q.initial: {message}"]
    else:
        assert accepted(tmp_path, text).robots["ned"].data["q"].initial is not None


def test_initial_values_of_fields_have_their_own_place(tmp_path: Path) -> None:
    text = (
        ROBOT
        + "      q:\n        id: 5\n        origin: server\n        fields:\n          a:\n            type: Byte\n"
    )
    assert problems(tmp_path, text + "            initial: 300\n") == [
        "F:16:robots.ned.data.q.fields.a.initial: does not fit into Byte, 0 to 255"
    ]


def test_one_mistake_hides_no_other(tmp_path: Path) -> None:
    text = (
        "version: 1\nflet: {}\nserver: {port: x}\npubsub: {}\n"
        "bridges:\n  a: {kind: nope, status_id: 4}\n  b: {kind: ros2, space: 2, status_id: 4}\n"
        "robots:\n  r: {bridge: c, data: {q: {id: 4, type: Dubel}, s: {id: 4, type: Double}}}\n  s: {bridg: b}\n"
    )
    keys = [line.split(": ")[0] for line in problems(tmp_path, text)]
    assert keys == [
        "F:2:flet",
        "F:3:server.port",
        "F:4:pubsub.security",
        "F:6:bridges.a.kind",
        "F:7:bridges.b.status_id",
        "F:9:robots.r.data.q.type",
        "F:9:robots.r.bridge",
        "F:9:robots.r.data.q.id",
        "F:9:robots.r.data.s.id",
        "F:10:robots.s.bridge",
        "F:10:robots.s.bridg",
    ]


def test_a_newer_version_is_one_line_with_the_remedy(tmp_path: Path) -> None:
    assert problems(tmp_path, "version: 2\nnew: {things: 1}\na: 1\na: 2\n") == [
        ("F:1:version: this file has version 2, and this ua-fleet reads version 1; upgrade ua-fleet (docs/install.md)")
    ]


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match=r"there is no such file; write a commented one: ua-fleet config init"):
        load(tmp_path / "no.yaml", {})
    with pytest.raises(ConfigInvalid, match="cannot be read: is a directory"):
        load(tmp_path, {})


def test_a_good_file_with_empty_sections(tmp_path: Path) -> None:
    config = accepted(tmp_path, HEAD + "server:\nbridges:\nrobots:\nfleet:\n")
    assert config.server.port == 4840
    assert config.bridges == {}


def test_data_of_a_robot_and_the_kinds_own_keys_arrive(tmp_path: Path) -> None:
    config = accepted(tmp_path, ROBOT + "      q: {id: 5, type: Double, unit: m}\n    description: x\n")
    assert config.robots["ned"].data["q"].unit == "m"
    assert config.bridges["cell"].model_dump()["master_uri"] == "http://127.0.0.1:11311"
    assert config.space_of("ned") == 1


def test_layers(tmp_path: Path) -> None:
    text = HEAD + "server: {port: 1, host: 10.0.0.1, path: a}\n"
    environment = {"UA_FLEET__SERVER__PORT": "2", "ua_fleet__server__host": "10.0.0.2", "UA_FLEET_LOG": "debug"}
    path = write(tmp_path, text)
    config = load(path, environment, overrides={"server.port": 3})
    assert (config.server.port, config.server.host, config.server.path) == (3, "10.0.0.2", "a")


def test_the_environment_reaches_sections_that_the_file_lacks_and_names_with_dashes(tmp_path: Path) -> None:
    text = HEAD + "bridges:\n  my-cell: {kind: ros2, space: 2, status_id: 1}\nserver:\n"
    environment = {
        "UA_FLEET__BRIDGES__MY_CELL__SPACE": "7",
        "UA_FLEET__BRIDGES__MY_CELL__DISCOVERY": "subnet",
        "UA_FLEET__SERVER__UNKNOWN_SOURCES": "ignore",
        "UA_FLEET__FLEET__NAME": "Hall",
    }
    config = accepted(tmp_path, text, environment)
    assert config.bridges["my-cell"].space == 7
    assert config.server.unknown_sources is UnknownSources.IGNORE
    assert config.fleet.name == "Hall"


ENVIRONMENT: list[tuple[str, str, str]] = [
    ("UA_FLEET__SERVER__PORT", "x", "environment:UA_FLEET__SERVER__PORT: must be a whole number, not `x`"),
    (
        "UA_FLEET__SERVER__PROT",
        "1",
        "environment:UA_FLEET__SERVER__PROT: there is no key `prot` under `server`; did you mean `port`?",
    ),
    ("UA_FLEET__SERVER", "1", "environment:UA_FLEET__SERVER: `server` has keys of its own; name one of these"),
    (
        "UA_FLEET__ROBOTS__NED__BRIDGE",
        "cell",
        "environment:UA_FLEET__ROBOTS__NED__BRIDGE: there is no key `ned` under `robots`",
    ),
    (
        "UA_FLEET__",
        "1",
        (
            "environment:UA_FLEET__: there is no key `` in the file; "
            "there are: `bridges`, `fleet`, `history`, `modbus`, `monitoring`, `pubsub`, `relays`, `resilience`, "
            "`robots`, `scenarios`, `server`, `sources`, `unified_namespace`, `version`"
        ),
    ),
    (
        "UA_FLEET__SERVER__PORT__X",
        "1",
        "environment:UA_FLEET__SERVER__PORT__X: there is no key `x` under `server.port`",
    ),
]


@pytest.mark.parametrize(("variable", "value", "message"), ENVIRONMENT)
def test_a_wrong_variable_is_named(variable: str, value: str, message: str, tmp_path: Path) -> None:
    assert problems(tmp_path, HEAD, {variable: value}) == [message]


def test_names_that_differ_only_in_case_cannot_be_told_apart(tmp_path: Path) -> None:
    text = BRIDGES + "robots:\n  ned: {bridge: cell}\n  Ned: {bridge: cell}\n"
    assert problems(tmp_path, text, {"UA_FLEET__ROBOTS__NED__BRIDGE": "floor"}) == [
        "environment:UA_FLEET__ROBOTS__NED__BRIDGE: `ned` may mean `Ned`, `ned` under `robots`; rename one of them"
    ]


def test_a_wrong_option_is_named(tmp_path: Path) -> None:
    assert problems(tmp_path, HEAD, options={"server.port": 70000}) == [
        "option:server.port: must be at most 65535, not 70000"
    ]


def test_a_missing_variable_is_told_once(tmp_path: Path) -> None:
    assert problems(tmp_path, HEAD + "server:\n  port: ${PORT}\n") == [
        "F:4:server.port: the environment variable PORT is not set; run: export PORT=..."
    ]
    assert accepted(tmp_path, HEAD + "server:\n  port: ${PORT}\n", {"PORT": "77"}).server.port == 77


@pytest.mark.parametrize("text", ["0123", "1e5", "true", "null", "~", "0x10", "1.50", "1e999", "-7"])
def test_a_text_of_the_environment_stays_one_where_a_text_is_wanted(tmp_path: Path, text: str) -> None:
    """What looks like a number was refused, with another text in the message: `1e5` was 100000.0."""
    fleet = "version: 1\npubsub:\n  security: none\n  url: mqtt://127.0.0.1:1883\n  broker:\n    user: "
    for written, environment in (("${U}", {"U": text}), ("x", {"UA_FLEET__PUBSUB__BROKER__USER": text})):
        config = accepted(tmp_path, f"{fleet}{written}\n", environment)
        assert config.pubsub.broker is not None
        assert config.pubsub.broker.user == text


def test_a_value_of_the_environment_is_what_its_key_wants(tmp_path: Path) -> None:
    text = (
        ROBOT.replace("    data:\n", "    description: ${D}\n")
        + "server:\n  state_dir: ${S}\n  port: ${P}\n  allow_anonymous: ${A}\n  host: x\n"
    )
    environment = {"D": "0123", "S": "2026", "P": "0123", "A": "true", "UA_FLEET__SERVER__HOST": "10"}
    config = accepted(tmp_path, text, environment)
    assert (config.robots["ned"].description, str(config.server.state_dir)) == ("0123", "2026")
    assert (config.server.port, config.server.allow_anonymous, config.server.host) == (123, True, "10")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("1e999", "must be a whole number, not `inf`"),
        ("true", "must be a whole number, not `true`"),
        ("99999", "must be at most 65535, not 99999"),
    ],
)
def test_what_is_no_number_of_the_environment_is_told_as_it_is(tmp_path: Path, given: str, said: str) -> None:
    assert problems(tmp_path, HEAD + "server:\n  port: ${PORT}\n", {"PORT": given}) == [f"F:4:server.port: {said}"]


@pytest.mark.parametrize("written", ["1e999", "-1e999"])
def test_a_number_that_is_too_large_is_not_taken_as_infinity(tmp_path: Path, written: str) -> None:
    shown = written.replace("1e999", "inf")
    assert problems(tmp_path, HEAD + f"server:\n  analog_rate_hz: {written}\n") == [
        f"F:4:server.analog_rate_hz: must be a finite number, not `{shown}`"
    ]


def test_nothing_stays_nothing_where_no_text_is_wanted(tmp_path: Path) -> None:
    text = (
        "version: 1\npubsub:\n  security: none\n  url: mqtt://127.0.0.1:1883\n  broker:\n    answer_timeout_s: ${T}\n"
    )
    for given in ("null", ""):
        broker = accepted(tmp_path, text, {"T": given}).pubsub.broker
        assert broker is not None
        assert broker.answer_timeout_s is None


class Counting(dict[Any, Any]):
    """Counts how often all of it was gone through."""

    passes = 0

    def items(self) -> Any:
        self.passes += 1
        return super().items()

    def values(self) -> Any:
        self.passes += 1
        return super().values()


@pytest.mark.parametrize("robots", [3, 60])
def test_the_checks_go_through_all_data_a_few_times_however_many_robots_there_are(
    robots: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Counting] = []
    whole = load_module.check_all

    def counted(parts: Parts) -> None:
        seen.append(Counting(parts.data))
        whole(replace(parts, data=seen[0]))

    monkeypatch.setattr(load_module, "check_all", counted)
    names = [f"r{number}" for number in range(robots)]
    text = "version: 1\npubsub: {security: none}\nbridges: {b: {kind: ros2, space: 2, status_id: 1}}\nrobots:\n"
    text += "".join(
        f"  {name}: {{bridge: b, data: {{x: {{id: {1001 + number}, type: Double}}}}}}\n"
        for number, name in enumerate(names)
    )
    config = load_module.load_content(text.encode(), "f.yaml", {})
    assert list(config.robots) == names
    assert seen[0].passes <= 8


def test_a_data_source_has_no_more_fields_than_the_server_reads(tmp_path: Path) -> None:
    def fleet(count: int) -> str:
        fields = "".join(f"          f{number}: {{type: Double}}\n" for number in range(count))
        return (
            "version: 1\npubsub: {security: none}\nbridges:\n  cell: {kind: ros1, status_id: 1}\n"
            f"robots:\n  ned:\n    bridge: cell\n    data:\n      much:\n        id: 2\n        fields:\n{fields}"
        )

    accepted(tmp_path, fleet(1990))
    text = "1991 fields; a data source has 1990 at most, or the server drops its description"
    assert problems(tmp_path, fleet(1991)) == [
        f"F:11:robots.ned.data.much.fields: {text}; spread them over several data sources"
    ]
