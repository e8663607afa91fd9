"""The example of docs/tcp.md, run as it stands there."""

from __future__ import annotations

import sys

from ua_bridges.tcp.driver import TcpDriver

from tests.contract.harness import Recorder
from tests.system import Processes, clean_environment, free_tcp_port
from tests.unit.docs.pages import ROOT, blocks
from tests.waiting import until
from ua_fleet.bridge.driver import Execution, ExecutionEnded, SampleRead
from ua_fleet.config.load import load_content

PAGE = ROOT / "docs" / "tcp.md"


def block(language: str) -> str:
    return next(found.text for found in blocks(language) if found.page == PAGE)


async def test_the_program_of_the_page_does_the_skill_of_the_page(processes: Processes) -> None:
    port = str(free_tcp_port())
    processes.start(sys.executable, "-c", block("python").replace("1025", port), env=clean_environment())
    config = load_content(block("yaml").replace("1025", port).encode(), "fleet.yaml", {})
    driver, recorder = TcpDriver(config, "press_cell"), Recorder()
    await driver.start(recorder)
    try:
        pick = next(skill for skill in driver.skills() if skill.name == "pick")
        driver.execute(Execution(bytes(16), pick.topic, pick.targets[0].id, (3,), 10.0))
        await until(lambda: any(isinstance(event, ExecutionEnded) for event in recorder.events), "the end")
        ended = next(event for event in recorder.events if isinstance(event, ExecutionEnded))
        assert ended.status == 0
        assert abs(ended.values[0] - 1.2) < 1e-6
        samples = [event for event in recorder.events if isinstance(event, SampleRead)]
        assert samples[0].values == (120.5, -30.0)
    finally:
        await driver.stop()
