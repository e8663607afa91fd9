"""The example of docs/modbus.md, run as it stands there against the simulated belt."""

from __future__ import annotations

from pathlib import Path

from ua_bridges.modbus.driver import create_driver

from tests.contract.harness import NUMBER, Recorder, message_of
from tests.contract.modbus import PlcProcess
from tests.system import free_tcp_port
from tests.unit.docs.pages import ROOT, blocks
from tests.waiting import until
from ua_fleet.bridge.driver import Execution, ExecutionEnded
from ua_fleet.config.load import load_content
from ua_fleet.topics import Topic

PAGE = ROOT / "docs" / "modbus.md"


async def test_the_belt_of_the_page_moves(tmp_path: Path) -> None:
    port = str(free_tcp_port())
    content = next(found.text for found in blocks("yaml") if found.page == PAGE).replace("5020", port)
    plc, recorder = PlcProcess("--program", "conveyor", "--port", port), Recorder()
    driver = create_driver(load_content(content.encode(), "fleet.yaml", {}), "hall")
    driver.remember_in(tmp_path)
    await driver.start(recorder)
    try:
        (move,) = driver.skills()
        driver.execute(Execution(bytes(16), move.topic, move.targets[0].id, (300, 600), 10.0))
        await until(lambda: any(isinstance(event, ExecutionEnded) for event in recorder.events), "the end")
        ended = next(event for event in recorder.events if isinstance(event, ExecutionEnded))
        assert (ended.status, ended.values) == (0, (300,))
        belt = Topic(300, 2, 1911)
        await until(lambda: recorder.samples(belt)[-1].values == (300.0, 0.0, False), "the belt's last values")
        assert any(sample.values[1:] == (0.6, True) for sample in recorder.samples(belt))
        lamp, gate = Topic(0, 2, 1912), Topic(301, 2, 1930)
        for topic in (lamp, gate):
            assert driver.publish(topic, NUMBER.metadata(topic.name), message_of(topic, True))
        await until(lambda: plc.do("cells", table="holding", address=190, count=2)["cells"] == [1, 16], "both bits")
    finally:
        await driver.stop()
        plc.end()
