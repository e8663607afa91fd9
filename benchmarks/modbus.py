"""Modbus: registers a second and round trips beside bare pymodbus, requests saved, and 20 devices polled each second.

The devices are another process (`_modbus.py`), and all of its values change with each reading. The driver's own
process is measured with everything that it does: requests, conversion, comparison, samples into an inlet.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncGenerator, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pymodbus.client import AsyncModbusTcpClient
from ua_bridges.modbus.config import DeviceConfig
from ua_bridges.modbus.device import Device
from ua_bridges.modbus.driver import ModbusDriver, create_driver
from ua_bridges.modbus.link import Line
from ua_bridges.modbus.sources import SourceSpec, source_specs

from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, at_most, shown
from tests import system
from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.load import load_content
from ua_fleet.registers import AddressSpan, Table

WORDS = 125
"""Of a full request."""
ROUND_TRIPS = 300
DEVICES, PER_DEVICE = 20, 500
POLLED_S = 5.0
GOAL_ROUND_TRIP = 1.5
GOAL_REGISTERS = 3.0
"""Times the cost of bare pymodbus, which converts nothing and compares nothing."""


@contextlib.contextmanager
def devices() -> Generator[int]:
    """The PLCs; their port."""
    port = system.free_tcp_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks._modbus", str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=system.clean_environment(PYTHONPATH=".:bridges:demo"),
        cwd=system.ROOT,
    )
    try:
        assert process.stdout is not None
        if process.stdout.readline().strip() != "ready":
            raise Failed("the simulated PLCs did not start")
        yield port
    finally:
        process.communicate(timeout=10)


class Counting:
    """An inlet that counts values."""

    def __init__(self) -> None:
        self.values = self.dropped = 0

    def put(self, event: DriverEvent) -> None:
        if isinstance(event, SampleRead):
            self.values += len(event.values)
        elif isinstance(event, Dropped):
            self.dropped += event.count


def fleet(port: int, count: int, period_s: float) -> bytes:
    """A fleet with `count` devices of 500 values each, words that are scaled."""
    hosts = {f"d{number}": {"host": f"127.0.0.{number + 1}", "port": port} for number in range(count)}
    data: dict[str, Any] = {}
    for number, device in enumerate(hosts):
        fields = {f"v{place}": {"type": "Double"} for place in range(PER_DEVICE)}
        registers = {
            f"v{place}": {"table": "holding", "address": place, "type": "int16", "scale": 0.1}
            for place in range(PER_DEVICE)
        }
        source = {"device": device, "registers": registers}
        data[device] = {"id": 1000 + number, "fields": fields, "source": source}
    bridge = {"kind": "modbus", "space": 300, "status_id": 1, "poll_s": period_s, "devices": hosts}
    document = {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"plcs": bridge},
        "robots": {"line": {"bridge": "plcs", "data": data}},
    }
    return json.dumps(document).encode()


async def bare_round_trip(port: int) -> list[float]:
    """Seconds of each request, one after the other."""
    client = AsyncModbusTcpClient("127.0.0.1", port=port)
    await client.connect()
    times: list[float] = []
    for _ in range(ROUND_TRIPS):
        began = time.perf_counter()
        await client.read_holding_registers(0, count=WORDS, device_id=1)
        times.append(time.perf_counter() - began)
    client.close()
    return times


async def our_round_trip(port: int) -> list[float]:
    """The same by the bridge's line, which checks what came."""
    line = Line(DeviceConfig(host="127.0.0.1", port=port), Path(), 1.0)
    if problem := await line.connect():
        raise Failed(problem)
    times: list[float] = []
    for _ in range(ROUND_TRIPS):
        began = time.perf_counter()
        await line.read(1, AddressSpan(Table.HOLDING, 0, WORDS))
        times.append(time.perf_counter() - began)
    line.close()
    return times


async def bare_registers(port: int) -> float:
    """Registers a second: four full requests again and again."""
    client = AsyncModbusTcpClient("127.0.0.1", port=port)
    await client.connect()
    began, read = time.perf_counter(), 0
    while time.perf_counter() - began < 1.0:
        for address in range(0, PER_DEVICE, WORDS):
            read += len((await client.read_holding_registers(address, count=WORDS, device_id=1)).registers)
    took = time.perf_counter() - began
    client.close()
    return read / took


async def our_registers(port: int) -> float:
    """Registers a second as samples: one device that is polled without a pause."""
    config = load_content(fleet(port, 1, 0.005), "fleet.json", {})
    specs: Sequence[SourceSpec] = [replace(spec, period_s=0.0) for spec in source_specs(config, "plcs")]
    device, inlet = DeviceConfig(host="127.0.0.1", port=port), Counting()
    work = asyncio.create_task(
        Device("d0", device, Line(device, Path(), 1.0), specs, (), inlet.put, Offenders(inlet)).run()
    )
    while not inlet.values:  # noqa: ASYNC110 -- it is told by nobody
        await asyncio.sleep(0.01)
    before, began = inlet.values, time.perf_counter()
    await asyncio.sleep(1.0)
    rate = (inlet.values - before) / (time.perf_counter() - began)
    while not work.done():  # Python 3.11's wait_for loses a cancellation that comes together with an answer
        work.cancel()
        await asyncio.wait([work], timeout=0.1)
    return rate


@contextlib.asynccontextmanager
async def polling(port: int) -> AsyncGenerator[tuple[ModbusDriver, Counting]]:
    """The driver with all devices, each polled each second."""
    driver, inlet = create_driver(load_content(fleet(port, DEVICES, 1.0), "fleet.json", {}), "plcs"), Counting()
    with tempfile.TemporaryDirectory() as folder:
        driver.remember_in(Path(folder))
        await driver.start(inlet)
        try:
            await asyncio.sleep(1.5)
            yield driver, inlet
        finally:
            await driver.stop()


async def polled(port: int) -> tuple[float, float, float, float]:
    """Values a second, CPU in percent of a core, requests in one round and values in one round."""
    async with polling(port) as (driver, inlet):
        if not driver.status().connected:
            raise Failed(driver.status().detail)
        values, cpu, began = inlet.values, time.process_time(), time.perf_counter()
        await asyncio.sleep(POLLED_S)
        took = time.perf_counter() - began
        cpu, values = time.process_time() - cpu, inlet.values - values
        if inlet.dropped:
            raise Failed(f"{inlet.dropped} readings were lost")
        told = re.findall(r"(\d+) values in (\d+) requests", driver.status().detail)
        in_all, requests = (float(sum(int(each[place]) for each in told)) for place in (0, 1))
        return values / took, 100 * cpu / took, requests, in_all


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    bare_times: list[float] = []
    our_times: list[float] = []
    bare_rates: list[float] = []
    our_rates: list[float] = []
    with devices() as port:
        for _ in range(rounds):
            bare_times += asyncio.run(bare_round_trip(port))
            our_times += asyncio.run(our_round_trip(port))
            bare_rates.append(asyncio.run(bare_registers(port)))
            our_rates.append(asyncio.run(our_registers(port)))
        rate, cpu, requests, values = asyncio.run(polled(port))
    bare_us, our_us = (1e6 * statistics.median(times) for times in (bare_times, our_times))
    bare_rate, our_rate = statistics.median(bare_rates), statistics.median(our_rates)
    return [
        at_most(
            "round trip of 125 registers, p50",
            our_us,
            "us",
            reference="bare pymodbus",
            reference_value=bare_us,
            goal=GOAL_ROUND_TRIP,
        ),
        at_most(
            "a register, read to a converted sample",
            1e6 / our_rate,
            "us",
            reference="bare pymodbus, the words alone",
            reference_value=1e6 / bare_rate,
            goal=GOAL_REGISTERS,
        ),
        shown(
            "registers a second", our_rate, "1/s", reference="bare pymodbus, the words alone", reference_value=bare_rate
        ),
        shown(
            "requests for 10,000 values",
            requests,
            "requests",
            reference="one for each value",
            reference_value=values,
        ),
        shown(
            "values a second, 20 devices polled each second",
            rate,
            "1/s",
            reference="10,000 registers",
            reference_value=values,
        ),
        shown("CPU of that, of one core", cpu, "%", reference="one core", reference_value=100.0),
    ]
