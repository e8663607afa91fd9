"""What `ua-fleet config check` says of registers: each mistake with its line, its key and its remedy."""

from __future__ import annotations

import pytest

from tests.config_problems import problems
from tests.unit.bridges.modbus.plc_fleet import HEAD

TWO = HEAD.replace("bridge: plc", "bridge: two")


def at(number: int, register: str, kind: str = "UInt16", name: str = "x") -> str:
    return f"      {name}: {{id: {number}, type: {kind}, source: {{at: {{{register}}}}}}}\n"


def sink(number: int, register: str, kind: str = "UInt16", name: str = "y") -> str:
    return f"      {name}: {{id: {number}, type: {kind}, origin: server, sink: {{at: {{{register}}}}}}}\n"


@pytest.mark.parametrize(
    "text",
    [
        HEAD + at(10, "table: holding, address: 99"),
        HEAD + at(10, "table: coil, address: 65535", "Boolean"),
        HEAD + at(10, "table: holding, address: 98, type: int32", "Double"),
        HEAD + at(10, "table: holding, address: 7, bit: 3", "Boolean") + at(11, "table: holding, address: 7", name="z"),
        HEAD
        + sink(10, "table: holding, address: 7, bit: 3", "Boolean")
        + sink(11, "table: holding, address: 7, bit: 4", "Boolean", "z"),
        HEAD + at(10, "table: holding, address: 7") + sink(11, "table: holding, address: 7"),
        HEAD.replace("write_words: 10}}", "tls: {ca: a.pem}}, b: {host: 10.0.0.7, unit: 2, tls: {ca: a.pem}}}"),
        HEAD.replace("write_words: 10}}", "tls: {ca: a.pem}}, b: {host: 10.0.0.7}}"),
        TWO + "      x: {id: 10, type: UInt16, source: {device: b, poll: fast, at: {table: input, address: 1}}}\n",
    ],
)
def test_maps_that_are_right(text: str) -> None:
    assert problems(text) == []


PLACE = "20:robots.press.data."
WRONG: list[tuple[str, str, str]] = [
    (
        "outside of the device",
        HEAD + at(10, "table: holding, address: 100"),
        f"{PLACE}x.source.at: holding 100 is outside of the device plc; its holding addresses: 0 to 99",
    ),
    (
        "half outside",
        HEAD + at(10, "table: holding, address: 99, type: int32", "Int32"),
        f"{PLACE}x.source.at: holding 99 to 100 is outside of the device plc; its holding addresses: 0 to 99",
    ),
    (
        "beyond every device",
        HEAD + at(10, "table: input, address: 65535, type: int32", "Int32"),
        f"{PLACE}x.source.at: input 65535 to 65536 is outside of the device plc; its input addresses: 0 to 65535",
    ),
    (
        "no address",
        HEAD + at(10, "table: holding, address: 65536"),
        f"{PLACE}x.source.at.address: must be at most 65535, not 65536",
    ),
    (
        "overlap",
        HEAD
        + at(10, "table: holding, address: 7, type: int32", "Int32")
        + at(11, "table: holding, address: 8", name="z"),
        (
            "21:robots.press.data.z.source.at: holding 8 overlaps holding 7 to 8 of robots.press.data.x.source.at; "
            "one of the two addresses or types is wrong"
        ),
    ),
    (
        "two writers",
        HEAD + sink(10, "table: holding, address: 7") + sink(11, "table: holding, address: 7", name="z"),
        (
            "21:robots.press.data.z.sink.at: holding 7 is written by robots.press.data.y.sink.at already; "
            "one of the two addresses or types is wrong"
        ),
    ),
    (
        "a word and then a bit of it",
        HEAD + sink(10, "table: holding, address: 7") + sink(11, "table: holding, address: 7, bit: 3", "Boolean", "z"),
        (
            "21:robots.press.data.z.sink.at: holding 7 is written by robots.press.data.y.sink.at already; "
            "one of the two addresses or types is wrong"
        ),
    ),
    (
        "a bit and then its word",
        HEAD
        + sink(10, "table: holding, address: 7, bit: 3", "Boolean")
        + sink(11, "table: holding, address: 7", name="z"),
        (
            "21:robots.press.data.z.sink.at: holding 7 is written by robots.press.data.y.sink.at already; "
            "one of the two addresses or types is wrong"
        ),
    ),
    (
        "no address at all",
        HEAD.replace("[[0, 99]]", "[]") + at(10, "table: holding, address: 7"),
        f"{PLACE}x.source.at: holding 7 is outside of the device plc; its holding addresses: none",
    ),
    (
        "deadband of a bit",
        HEAD + at(10, "table: holding, address: 7, bit: 3, deadband: 1", "Boolean"),
        f"{PLACE}x.source.at: scale, offset and deadband are for numbers",
    ),
    (
        "bit of a number",
        HEAD + at(10, "table: holding, address: 7, bit: 3"),
        f"{PLACE}x.source.at: bit: only a bool has one",
    ),
    (
        "scale beyond everything",
        HEAD + at(10, "table: holding, address: 7, type: uint64, scale: 1e300"),
        f"{PLACE}x.source.at: uint64 as scaled goes from 0 to 1.84e+319, UInt16 from 0 to 65535",
    ),
    (
        "wrong type",
        HEAD + at(10, "table: holding, address: 7, type: float32"),
        f"{PLACE}x.source.at: float32 has fractions, which UInt16 has not; use Float or Double",
    ),
    (
        "sign",
        HEAD + at(10, "table: holding, address: 7, type: int16"),
        f"{PLACE}x.source.at: int16 goes from -32768 to 32767, UInt16 from 0 to 65535",
    ),
    (
        "type that follows from nothing",
        HEAD + at(10, "table: holding, address: 7", "Byte"),
        f"{PLACE}x.source.at: `type` is needed: a Byte follows from no register",
    ),
    (
        "bool without its bit",
        HEAD + at(10, "table: holding, address: 7", "Boolean"),
        f"{PLACE}x.source.at: a Boolean in a word needs its `bit`, 0 to 15",
    ),
    (
        "number in a coil",
        HEAD + at(10, "table: coil, address: 7"),
        f"{PLACE}x.source.at: bool is no UInt16",
    ),
    (
        "read-only table",
        HEAD + sink(10, "table: input, address: 7"),
        f"{PLACE}y.sink.at.table: input registers cannot be written; use holding or coil",
    ),
    (
        "longer than a request",
        HEAD + sink(10, "table: holding, address: 7, length: 11", "String"),
        f"{PLACE}y.sink.at: holding 7 to 17 takes 11 addresses, and a request to plc at most 10; make it shorter",
    ),
    (
        "array",
        HEAD + "      x: {id: 10, type: UInt16, array: true, source: {at: {table: holding, address: 1}}}\n",
        f"{PLACE}x.source.at: registers hold no arrays; name each value as a field of its own",
    ),
    (
        "no source",
        HEAD + "      x: {id: 10, type: UInt16}\n",
        f"{PLACE}x.source: `source` is missing; say which registers it is read from: source: {{at: ...}}",
    ),
    (
        "field without a register",
        HEAD
        + "      x: {id: 10, fields: {a: {type: UInt16}, b: {type: UInt16}}, "
        + "source: {registers: {a: {table: holding, address: 1}}}}\n",
        f"{PLACE}x.source: the field `b` has no register; add it under `registers`",
    ),
    (
        "register without a field",
        HEAD
        + "      x: {id: 10, fields: {alpha: {type: UInt16}}, source: {registers: "
        + "{alpha: {table: holding, address: 1}, alpah: {table: holding, address: 2}}}}\n",
        f"{PLACE}x.source.registers.alpah: there is no field `alpah`; did you mean `alpha`?",
    ),
    (
        "at for fields",
        HEAD + "      x: {id: 10, fields: {a: {type: UInt16}}, source: {at: {table: holding, address: 1}}}\n",
        f"{PLACE}x.source: the data needs `registers`, since it has `fields`",
    ),
    (
        "which device",
        TWO + at(10, "table: holding, address: 1"),
        f"{PLACE}x.source: `device` is missing; there are `a`, `b`; say which one",
    ),
    (
        "no such device",
        TWO + "      x: {id: 10, type: UInt16, source: {device: c, at: {table: holding, address: 1}}}\n",
        f"{PLACE}x.source.device: there is no device `c`; there are: `a`, `b`",
    ),
    (
        "no such poll group",
        TWO + "      x: {id: 10, type: UInt16, source: {device: a, poll: fats, at: {table: holding, address: 1}}}\n",
        f"{PLACE}x.source.poll: there is no poll group `fats`; did you mean `fast`?",
    ),
    (
        "unknown key",
        HEAD + at(10, "table: holding, adress: 1, address: 2"),
        f"{PLACE}x.source.at.adress: unknown key `adress`; did you mean `address`?",
    ),
    (
        "mirror of nobody",
        HEAD.replace("write_words: 10}}", "write_words: 10}}\n    mirrors: {rover.x: {at: {table: coil, address: 1}}}")
        + at(10, "table: holding, address: 1"),
        "9:bridges.plc.mirrors.rover.x: there is no robot `rover`",
    ),
    (
        "mirror of its own",
        HEAD.replace("write_words: 10}}", "write_words: 10}}\n    mirrors: {press.x: {at: {table: coil, address: 1}}}")
        + at(10, "table: holding, address: 1"),
        (
            "9:bridges.plc.mirrors.press.x: press is a robot of this bridge; data that clients write has a `sink`; "
            "data that is read from it stays in it"
        ),
    ),
    (
        "two ways to one device",
        HEAD.replace("write_words: 10}}", "write_words: 10}, other: {host: 10.0.0.7}}"),
        "8:bridges.plc.devices: other and plc are one device, 10.0.0.7:502, unit 1",
    ),
    (
        "a second unit without the TLS of the first",
        HEAD.replace("write_words: 10}}", "port: 802, tls: {ca: plc.pem}}, b: {host: 10.0.0.7, port: 802, unit: 2}}"),
        (
            "8:bridges.plc.devices: b and plc share 10.0.0.7:802, and say different things of it; "
            "give both the same `tls`"
        ),
    ),
    (
        "a second unit with TLS behind one without",
        HEAD.replace(
            "write_words: 10}}", "write_words: 10}, b: {host: 10.0.0.7, port: 502, unit: 2, tls: {ca: a.pem}}}"
        ),
        (
            "8:bridges.plc.devices: b and plc share 10.0.0.7:502, and say different things of it; "
            "give both the same `tls`"
        ),
    ),
    (
        "a second unit that trusts another certificate",
        HEAD.replace("write_words: 10}}", "tls: {ca: a.pem}}, b: {host: 10.0.0.7, unit: 2, tls: {ca: b.pem}}}"),
        (
            "8:bridges.plc.devices: b and plc share 10.0.0.7:802, and say different things of it; "
            "give both the same `tls`"
        ),
    ),
    (
        "a serial line of two speeds",
        HEAD.replace(
            "host: 10.0.0.7,",
            "serial: {tty: /dev/ttyS0}}, b: {serial: {tty: /dev/ttyS0, baudrate: 9600}, unit: 2,",
        ),
        (
            "8:bridges.plc.devices: b and plc share /dev/ttyS0, and say different things of it; "
            "give both the same `serial`"
        ),
    ),
    (
        "unit of a line",
        HEAD.replace("host: 10.0.0.7", "serial: {tty: /dev/ttyS0}, unit: 0"),
        "8:bridges.plc.devices.plc: unit: on a serial line 1 to 247",
    ),
    (
        "no vendor space",
        HEAD.replace("space: 300", "space: 30"),
        "6:bridges.plc.space: a bridge of this kind has a vendor space of its own, 256 to 65535",
    ),
]


def test_mistake_within_a_source_is_told_alone() -> None:
    text = HEAD + at(10, "table: holding, address: 70000") + sink(11, "table: holding, adress: 1")
    assert [each.split(":")[1].split(" ")[0] for each in problems(text)] == [
        "robots.press.data.x.source.at.address",
        "robots.press.data.y.sink.at.address",
        "robots.press.data.y.sink.at.adress",
    ]


@pytest.mark.parametrize(("text", "problem"), [each[1:] for each in WRONG], ids=[each[0] for each in WRONG])
def test_each_mistake_is_said_with_its_line(text: str, problem: str) -> None:
    assert problem in problems(text)
