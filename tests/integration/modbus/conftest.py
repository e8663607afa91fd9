"""A Modbus driver on its own, with a recorder in place of the bridge."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from ua_bridges.modbus.driver import create_driver
from ua_bridges.modbus.session import ModbusDriver

from tests.contract.harness import Recorder
from ua_fleet.bridge import SampleRead
from ua_fleet.config.load import load_content
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, Variant, status_name

Start = Callable[..., Awaitable["Bench"]]


class Bench:
    """A started driver and what it tells."""

    def __init__(self, driver: ModbusDriver, recorder: Recorder) -> None:
        self.driver, self.recorder = driver, recorder

    def values(self, id: int) -> tuple[Any, ...] | None:
        """The last values of a source; a Bad field is the name of its status."""
        samples = self.recorder.samples(Topic(300, 2, id))
        return None if not samples else tuple([shown(value) for value in samples[-1].values])

    def all_values(self, id: int) -> list[tuple[Any, ...]]:
        """All of them."""
        events = self.recorder.of(Topic(300, 2, id))
        return [tuple([shown(value) for value in event.values]) for event in events if isinstance(event, SampleRead)]


def shown(value: Any) -> Any:
    """A value, or the name of the status of a Bad field."""
    return status_name(value.value) if isinstance(value, Variant) and value.type == BuiltinType.STATUS_CODE else value


@pytest.fixture
async def start(tmp_path: Path) -> AsyncIterator[Start]:
    """Starts a driver: `await start(devices, data, **bridge)`; its robot is named `machine`."""
    benches: list[Bench] = []

    async def begin(devices: dict[str, Any], data: dict[str, Any], **more: Any) -> Bench:
        fleet = {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {
                "plc": {"kind": "modbus", "space": 300, "status_id": 1, "poll_s": 0.02, "devices": devices, **more}
            },
            "robots": {"machine": {"bridge": "plc", "data": data}},
        }
        driver, recorder = (
            create_driver(load_content(yaml.safe_dump(fleet, sort_keys=False).encode(), "F", {}), "plc"),
            Recorder(),
        )
        driver.remember_in(tmp_path)
        await driver.start(recorder)
        benches.append(Bench(driver, recorder))
        return benches[-1]

    yield begin
    for bench in benches:
        await bench.driver.stop()
