"""The driver beside real devices: ptys, a D-Bus of its own, and a udev that umockdev plays."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
from ua_bridges.plugged.driver import PluggedDriver

from tests.contract.harness import Recorder
from tests.system import ROOT, Processes, clean_environment
from tests.waiting import until
from ua_fleet.bridge.driver import Execution, ExecutionEnded, ExecutionForgotten
from ua_fleet.config.load import load_content
from ua_fleet.topics import Topic

BUS_CONFIG = """\
<!DOCTYPE busconfig PUBLIC "-//freedesktop//DTD D-BUS Bus Configuration 1.0//EN"
 "http://www.freedesktop.org/standards/dbus/1.0/busconfig.dtd">
<busconfig>
  <listen>unix:path={path}</listen>
  <auth>EXTERNAL</auth>
  <policy context="default">
    <allow send_destination="*" eavesdrop="true"/>
    <allow eavesdrop="true"/>
    <allow own="*"/>
  </policy>
</busconfig>
"""

ROVER = """
version: 1
pubsub: {security: none}
bridges: {pc: {kind: plugged, space: 300, status_id: 1, bus: "ADDRESS"}}
robots:
  rover_pc:
    bridge: pc
    skill_status_id: 1902
    data:
      gas: {id: 10, type: Double, source: {signal: trbots.gas}}
"""
"""A fleet of one robot with the bus at ADDRESS; its first value is there, and more data, then skills, may follow."""


class Bridge:
    """A driver at work, and what it tells."""

    def __init__(self, text: str) -> None:
        config = load_content(text.encode(), "fleet.yaml", {})
        self.driver = PluggedDriver(config, "pc")
        self.recorder = Recorder()
        self._number = 0

    def topic(self, id: int) -> Topic:
        return Topic(300, 2, id)

    def values(self, id: int) -> list[Any]:
        """The values that were read, first fields alone."""
        return [sample.values[0] for sample in self.recorder.samples(self.topic(id)) if sample.status == 0]

    def statuses(self, id: int) -> list[int]:
        return [sample.status for sample in self.recorder.samples(self.topic(id))]

    def want(self, *ids: int) -> None:
        self.driver.want(frozenset(map(self.topic, ids)))

    async def found(self, id: int, times: int = 1) -> None:
        await until(lambda: len(self.recorder.found(self.topic(id))) >= times, f"the source {id}")

    def begin(self, id: int, *values: Any) -> Execution:
        self._number += 1
        execution = Execution(self._number.to_bytes(16, "big"), self.topic(id), 1, values, 5.0)
        self.driver.execute(execution)
        return execution

    async def end(self, execution: Execution) -> ExecutionEnded | ExecutionForgotten:
        def ends() -> list[ExecutionEnded | ExecutionForgotten]:
            kinds = (ExecutionEnded, ExecutionForgotten)
            events = list(self.recorder.events)
            return [e for e in events if isinstance(e, kinds) and e.execution_id == execution.execution_id]

        await until(ends, "the end")
        assert len(ends()) == 1
        return ends()[0]


@contextlib.asynccontextmanager
async def started(text: str) -> AsyncGenerator[Bridge]:
    """A driver for a `fleet.yaml` whose bridge is `pc`, in space 300."""
    bridge = Bridge(text)
    await bridge.driver.start(bridge.recorder)
    try:
        yield bridge
    finally:
        await bridge.driver.stop()


class BusDaemon:
    """A bus of its own, which can be ended and started again at its address."""

    def __init__(self, folder: Path, processes: Processes) -> None:
        self._config, self._processes = folder / "bus.conf", processes
        self.path = folder / "bus"
        self.address = f"unix:path={self.path}"
        self._config.write_text(BUS_CONFIG.format(path=self.path))
        self.start()

    def start(self) -> None:
        self.path.unlink(missing_ok=True)
        self._daemon = self._processes.start(
            "dbus-daemon", f"--config-file={self._config}", "--nofork", "--print-address=1"
        )
        self._daemon.wait_for("unix:path=")

    def end(self) -> None:
        self._daemon.end()


@pytest.fixture
def bus(tmp_path: Path, processes: Processes) -> BusDaemon:
    return BusDaemon(tmp_path, processes)


class UdevBench:
    """A driver in a process of its own, with devices that umockdev plays; see `udev_bench.py`."""

    def __init__(self, fleet: Path) -> None:
        self._events: list[dict[str, Any]] = []
        self._others: list[str] = []
        self._done = threading.Semaphore(0)
        self._process = subprocess.Popen(
            ["umockdev-wrapper", sys.executable, "-u", str(Path(__file__).with_name("udev_bench.py")), str(fleet)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=clean_environment(PYTHONPATH=os.pathsep.join([str(ROOT), str(ROOT / "bridges")])),
        )
        self._answer: dict[str, Any] = {}
        self._reader = threading.Thread(target=self._read, name="bench-reader", daemon=True)
        self._reader.start()
        self.root = Path(self.answer()["root"])

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if not line.startswith("{"):
                self._others.append(line)
                continue
            said: dict[str, Any] = json.loads(line)
            self._events.append(said)
            if "event" not in said:
                self._answer = said
                self._done.release()

    def answer(self) -> dict[str, Any]:
        if not self._done.acquire(timeout=20):
            raise AssertionError("".join(self._others))
        return self._answer

    def do(self, what: str, **rest: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": what, **rest}) + "\n")
        self._process.stdin.flush()
        return self.answer()

    def plug(
        self, subsystem: str, name: str, parent: str | None = None, *, attributes: Any = None, properties: Any = None
    ) -> str:
        """Plug a device in; its path below /sys."""
        given: dict[str, Any] = {"attributes": attributes or {}, "properties": properties or {}}
        return str(self.do("plug", subsystem=subsystem, name=name, parent=parent, **given)["path"])

    def of(self, event: str, id: int) -> list[Any]:
        return [said.get("values") for said in list(self._events) if (said.get("event"), said.get("id")) == (event, id)]

    def values(self, id: int) -> list[Any]:
        return [values[0] for values in self.of("read", id)]

    def log(self) -> str:
        return "".join(self._others)

    def status(self) -> str:
        return str(self.do("status")["detail"])

    def end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(5)
        assert self._process.stdout is not None
        self._process.stdout.close()
