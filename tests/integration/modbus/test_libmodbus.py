"""The driver reads and writes a server that was built on libmodbus."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.contract.harness import NUMBER, message_of
from tests.integration.modbus.conftest import Start
from tests.system import Processes
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

SOURCE = Path(__file__).with_name("libmodbus_server.c")

pytestmark = pytest.mark.needs("libmodbus")


@pytest.fixture
def server(tmp_path: Path, tcp_port: int, processes: Processes) -> int:
    """The C program, built and started; its port."""
    binary = tmp_path / "libmodbus_server"
    subprocess.run(["gcc", "-Wall", "-Werror", "-o", binary, SOURCE, "-lmodbus"], check=True, capture_output=True)
    processes.start(binary, str(tcp_port)).wait_for("ready")
    return tcp_port


def at(table: str, address: int, kind: str, **more: Any) -> dict[str, Any]:
    return {"table": table, "address": address, "type": kind, **more}


async def test_all_tables_and_orders_are_read(server: int, start: Start) -> None:
    fields: dict[str, tuple[str, dict[str, Any], Any]] = {
        "coil0": ("Boolean", at("coil", 0, "bool"), True),
        "coil1": ("Boolean", at("coil", 1, "bool"), False),
        "coil63": ("Boolean", at("coil", 63, "bool"), True),
        "input1": ("Boolean", at("discrete", 1, "bool"), False),
        "input62": ("Boolean", at("discrete", 62, "bool"), True),
        "word": ("UInt16", at("holding", 99, "uint16"), 693),
        "bit": ("Boolean", at("holding", 1, "bool", bit=2), True),
        "long": ("UInt32", at("holding", 2, "uint32"), (14 << 16) + 21),
        "read": ("Double", at("input", 199, "uint16", scale=0.1), 218.9),
        "abcd": ("Float", at("holding", 100, "float32", order="ABCD"), 12.5),
        "cdab": ("Float", at("holding", 102, "float32", order="CDAB"), 12.5),
        "badc": ("Float", at("holding", 104, "float32", order="BADC"), 12.5),
        "dcba": ("Float", at("holding", 106, "float32", order="DCBA"), 12.5),
    }
    data = {
        "all": {
            "id": 10,
            "fields": {name: {"type": kind} for name, (kind, _, _) in fields.items()},
            "source": {"registers": {name: register for name, (_, register, _) in fields.items()}},
        }
    }
    bench = await start({"plc": {"host": "127.0.0.1", "port": server, "most_gap": 0}}, data)
    await until(lambda: bench.values(10), "the values")
    assert bench.values(10) == tuple(value for _, _, value in fields.values())
    assert "13 values in 7 requests, 6 saved" in bench.driver.status().detail


async def test_what_is_written_arrives_and_is_read_back(server: int, start: Start) -> None:
    data = {
        "wanted": {
            "id": 11,
            "type": "UInt16",
            "origin": "server",
            "sink": {"at": at("holding", 150, "uint16"), "read_back": True},
        },
        "seen": {"id": 10, "type": "UInt16", "source": {"at": at("input", 150, "uint16")}},
        "flag": {
            "id": 12,
            "type": "Boolean",
            "origin": "server",
            "sink": {"at": at("holding", 151, "bool", bit=15), "read_back": True},
        },
        "word": {"id": 13, "type": "UInt16", "source": {"at": at("holding", 151, "uint16")}},
    }
    bench = await start({"plc": {"host": "127.0.0.1", "port": server}}, data)
    await until(lambda: bench.values(10) == (150 * 7,), "the value before")
    for number, value in ((11, 4711), (12, True)):
        topic = Topic(0, 2, number)
        assert bench.driver.publish(topic, NUMBER.metadata(topic.name), message_of(topic, value))
    await until(lambda: bench.values(10) == (4711,), "the value after")
    await until(lambda: bench.values(13) == (151 * 7 | 0x8000,), "the bit, and the others as they were")
    assert bench.recorder.dropped(Drop.REJECTED) == 0


async def test_address_that_the_device_does_not_have_spoils_no_other(server: int, start: Start) -> None:
    data = {
        "two": {
            "id": 10,
            "fields": {"last": {"type": "UInt16"}, "beyond": {"type": "UInt16"}},
            "source": {"registers": {"last": at("holding", 199, "uint16"), "beyond": at("holding", 200, "uint16")}},
        }
    }
    bench = await start({"plc": {"host": "127.0.0.1", "port": server}}, data)
    await until(lambda: bench.values(10), "the values")
    assert bench.values(10) == (1393, "BadConfigurationError")
    assert bench.driver.status().connected
    assert bench.recorder.dropped(Drop.REJECTED) >= 2
