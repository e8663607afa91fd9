"""The driver over TLS, and over a serial line with several units."""

from __future__ import annotations

import asyncio
import os
import select
import subprocess
import sys
import threading
import tty
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.contract.harness import NUMBER, message_of
from tests.contract.modbus import PlcProcess
from tests.integration.modbus.conftest import Start
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.errors import BridgeUnavailable
from ua_fleet.topics import Topic


def holding(id: int, address: int, device: str | None = None) -> dict[str, Any]:
    source: dict[str, Any] = {"at": {"table": "holding", "address": address}}
    return {"id": id, "type": "UInt16", "source": source if device is None else {"device": device, **source}}


@pytest.fixture
def plc() -> Iterator[Any]:
    """Starts simulated PLCs."""
    started: list[PlcProcess] = []

    def start(*options: str) -> PlcProcess:
        started.append(PlcProcess(*options))
        return started[-1]

    yield start
    for each in started:
        each.end()


class SerialLine:
    """Two pseudo terminals with a cable between them."""

    def __init__(self) -> None:
        self._ends = [os.openpty(), os.openpty()]
        for main, other in self._ends:
            tty.setraw(main)
            tty.setraw(other)
        self.names = [os.ttyname(other) for _, other in self._ends]
        self._stop, self._stopped = os.pipe()
        self._thread = threading.Thread(target=self._carry, name="serial-line")
        self._thread.start()

    def _carry(self) -> None:
        one, two = (main for main, _ in self._ends)
        other = {one: two, two: one}
        while True:
            ready, _, _ = select.select([one, two, self._stop], [], [])
            if self._stop in ready:
                return
            for end in ready:
                os.write(other[end], os.read(end, 4096))

    def close(self) -> None:
        """Take the cable away."""
        os.write(self._stopped, b"x")
        self._thread.join()
        for end in (*(number for pair in self._ends for number in pair), self._stop, self._stopped):
            os.close(end)


@pytest.fixture
def line() -> Iterator[SerialLine]:
    cable = SerialLine()
    yield cable
    cable.close()


async def test_units_on_a_serial_line(line: SerialLine, plc: Any, start: Start) -> None:
    there = plc("--tty", line.names[0], "--parity", "none", "--unit", "1", "--unit", "2")
    there.do("put", table="holding", address=5, type="uint16", values=[111], unit=1)
    there.do("put", table="holding", address=5, type="uint16", values=[222], unit=2)
    serial = {"tty": line.names[1], "baudrate": 19200, "parity": "none"}
    devices = {
        name: {"serial": dict(serial), "unit": unit, "timeout_s": 0.3, "retries": 0, "retry_s": [0.1, 0.2]}
        for name, unit in (("one", 1), ("two", 2), ("nobody", 9))
    }
    data = {
        "a": holding(10, 5, "one"),
        "b": holding(11, 5, "two"),
        "c": holding(12, 5, "nobody"),
        "d": {
            "id": 13,
            "type": "UInt16",
            "origin": "server",
            "sink": {"device": "two", "at": {"table": "holding", "address": 6}, "read_back": True},
        },
    }
    bench = await start(devices, data)
    await until(lambda: bench.values(10) and bench.values(11), "both values")
    assert (bench.values(10), bench.values(11), bench.values(12)) == ((111,), (222,), None)
    detail = bench.driver.status().detail
    assert f"2 of 3 devices answer; nobody ({line.names[1]}, unit 9): no answer to holding 5 within 0.3 s" in detail
    topic = Topic(0, 2, 13)
    assert bench.driver.publish(topic, NUMBER.metadata(topic.name), message_of(topic, 333))
    await until(lambda: there.do("cells", table="holding", address=6, count=1, unit=2)["cells"] == [333], "the write")
    assert bench.recorder.dropped(Drop.REJECTED) == 0


@pytest.fixture
async def undecodable() -> AsyncIterator[str]:
    """A serial line on which each request gets an answer of function 12 that is too short, with the right checksum."""
    main, other = os.openpty()
    tty.setraw(other)

    def answer() -> None:
        os.read(main, 256)
        os.write(main, bytes.fromhex("010c002500"))

    loop = asyncio.get_running_loop()
    loop.add_reader(main, answer)
    yield os.ttyname(other)
    loop.remove_reader(main)
    for end in (main, other):
        os.close(end)


async def test_answer_on_a_serial_line_that_cannot_be_decoded_is_the_devices_mistake(
    undecodable: str, start: Start
) -> None:
    serial = {"tty": undecodable, "baudrate": 19200, "parity": "none"}
    bench = await start({"plc": {"serial": serial, "timeout_s": 0.1, "retries": 0}}, {"a": holding(10, 5)})
    await until(lambda: bench.recorder.dropped(Drop.MALFORMED), "the drop")


def certificate(folder: Path, name: str) -> None:
    """A certificate for localhost, signed by itself."""
    subprocess.run(
        f"openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN={name} -addext subjectAltName=IP:127.0.0.1 "
        f"-keyout {name}.key -out {name}.pem".split(),
        cwd=folder,
        check=True,
        capture_output=True,
    )


async def test_tls_with_the_header_of_modbus_tcp(plc: Any, start: Start, tmp_path: Path, tcp_port: int) -> None:
    certificate(tmp_path, "plc")
    there = plc("--port", str(tcp_port), "--certificate", str(tmp_path / "plc.pem"), "--key", str(tmp_path / "plc.key"))
    there.do("put", table="holding", address=5, type="uint16", values=[111])
    device = {"host": "127.0.0.1", "port": tcp_port, "tls": {"ca": "plc.pem"}}
    bench = await start({"plc": device}, {"a": holding(10, 5)})
    await until(lambda: bench.values(10) == (111,), "the value")
    # The bytes inside are an ADU with its header, as MODBUS/TCP Security has it.
    program = (
        "import socket, ssl, sys; c = ssl.create_default_context(cafile=sys.argv[1]);"
        "s = c.wrap_socket(socket.create_connection(('127.0.0.1', int(sys.argv[2]))), server_hostname='127.0.0.1');"
        "s.sendall(bytes.fromhex('000100000006010300050001')); print(s.recv(100).hex())"
    )
    run = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "plc.pem"), str(tcp_port)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.strip() == "000100000005010302006f"


async def test_device_with_another_certificate_is_not_believed(
    plc: Any, start: Start, tmp_path: Path, tcp_port: int
) -> None:
    certificate(tmp_path, "plc")
    certificate(tmp_path, "other")
    plc("--port", str(tcp_port), "--certificate", str(tmp_path / "plc.pem"), "--key", str(tmp_path / "plc.key"))
    device = {"host": "127.0.0.1", "port": tcp_port, "tls": {"ca": "other.pem"}, "retry_s": [0.05, 0.1]}
    bench = await start({"plc": device}, {"a": holding(10, 5)})
    await until(lambda: "certificate verify failed" in bench.driver.status().detail, "the reason")
    assert bench.values(10) is None


async def test_missing_file_of_tls_is_said_at_the_start(start: Start, tcp_port: int) -> None:
    device = {"host": "127.0.0.1", "port": tcp_port, "tls": {"ca": "no.pem"}}
    with pytest.raises(BridgeUnavailable, match=r"tls: .*the files are looked for in"):
        await start({"plc": device}, {"a": holding(10, 5)})
