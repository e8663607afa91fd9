"""Texts of 1 MB in each place in which a person can write one: refused in one line, and all else goes on."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any, Final

import pytest
import pytest_asyncio

from tests.integration.console.conftest import rover_server
from tests.integration.console.harness import ENGINEER, Console, console_at
from tests.integration.console.test_feeds import SCENARIO

LARGE: Final = "x" * 1_000_000
WRITTEN: Final[dict[str, dict[str, Any]]] = {
    "fault.raise": {"robot": "rover", "reason": LARGE},
    "alarm.acknowledge": {"alarm": "ns=2;s=Fleet.Faults.rover.robot", "event": "00", "comment": LARGE},
    "alarm.shelve": {"alarm": LARGE, "time_s": 60},
    "robots.hold": {"robot": "rover", "reason": LARGE},
    "robots.release": {"robot": LARGE},
    "skill.start": {"robot": "rover", "skill": "goto", "arguments": {"x": LARGE}},
    "scenario.validate": {"scenario": LARGE},
    "scenario.outline": {"scenario": LARGE},
    "scenario.store": {"name": "large", "text": LARGE},
    "scenario.text": {"name": LARGE},
    "scenario.dry_run": {"scenario": SCENARIO, "parameters": {"x": LARGE}},
    "scenario.run": {"scenario": "there", "parameters": {"x": LARGE}},
    "run.abort": {"run": "1", "reason": LARGE},
    "run.answer": {"run": "1", "step": LARGE, "answer": "retry"},
    "resilience.confirm": {"decision": "1", "robot": LARGE},
    "resilience.judge": {"decision": "1", "judgements": {LARGE: 1.0}},
    "node.write": {"node": "ns=2;i=1005", "value": LARGE},
    "node.browse": {"node": LARGE},
}

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def console(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Console]:
    """One for all of them, which none of them changes."""
    folder = tmp_path_factory.mktemp("rover")
    async with rover_server(folder) as server, console_at(folder, {"hall": server.url}) as running:
        yield running


@pytest.mark.parametrize("operation", WRITTEN)
async def test_a_large_text_is_refused_in_one_line(console: Console, operation: str) -> None:
    async with console.logged_in(ENGINEER) as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.until(lambda: "rover" in live.feeds.get("all", {}))
        answer = await browser.ask(operation, **WRITTEN[operation])
        assert 400 <= answer.status_code < 500, answer.text[:300]
        message: str = answer.json()["error"]["message"]
        assert 10 < len(message) < 500
        assert len(answer.content) < 2000, "what somebody has given comes back"
        assert "\n" not in message
        assert "unknown operation" not in message.lower()
        held = await browser.ask("robots.hold", robot="rover", reason="the page lives")
        assert held.status_code == 200, held.text
        await live.until(lambda: live.feeds["all"]["rover"]["held"])
        released = await browser.ask("robots.release", robot="rover")
        assert released.status_code == 200, released.text
        await live.until(lambda: not live.feeds["all"]["rover"]["held"])
        health = (await browser.http.get("healthz")).json()
        assert health["mistakes"] == {}
