"""One item, one mistake: counted, logged once, shown, and what follows goes on."""

from __future__ import annotations

import asyncio
from math import inf

import pytest
from structlog.testing import capture_logs

from ua_fleet.monitoring import Mistakes, Monitor, ProcessKind
from ua_fleet.monitoring import mistakes as module


def test_a_mistake_is_counted_each_time_and_logged_once() -> None:
    mistakes = Mistakes()
    with capture_logs() as log:
        for number in range(3):
            with mistakes.guard("items", topic="t"):
                raise ValueError(f"bad number {number}")
    assert mistakes.counts == {"items": 3}
    ((entry),) = log
    assert (entry["loop"], entry["topic"], entry["log_level"]) == ("items", "t", "error")
    assert isinstance(entry["exc_info"], ValueError)
    assert entry["exc_info"].__traceback__ is not None
    assert "3 mistakes since the start" in mistakes.text()
    assert "items: ValueError: bad number 2 (test_mistakes.py:" in mistakes.text()


def test_each_kind_is_told_and_not_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_TOLD", 2)
    mistakes = Mistakes()
    with capture_logs() as log:
        for error in (ValueError, KeyError, TypeError):
            with mistakes.guard("items"):
                raise error("x")
    assert len(log) == 2
    assert mistakes.count == 3


def test_what_ends_a_task_or_the_process_is_no_mistake() -> None:
    mistakes = Mistakes()
    for error in (asyncio.CancelledError, KeyboardInterrupt, SystemExit):
        with pytest.raises(error), mistakes.guard("items"):
            raise error
    assert mistakes.count == 0
    assert mistakes.text() == ""


async def test_a_task_that_must_not_end_runs_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PAUSE_S", 0.0)
    mistakes, runs = Mistakes(), 0

    async def work() -> None:
        nonlocal runs
        runs += 1
        if runs < 3:
            raise ValueError("no")

    await mistakes.keep("work", work)
    assert (runs, mistakes.counts["work"]) == (3, 2)


async def test_a_task_that_fails_while_it_is_ended_is_over() -> None:
    mistakes, begun = Mistakes(), asyncio.Event()

    async def work() -> None:
        begun.set()
        try:
            await asyncio.sleep(inf)
        finally:
            raise ValueError("cannot hang up")

    task = asyncio.ensure_future(mistakes.keep("work", work))
    await begun.wait()
    task.cancel()
    with pytest.raises(ValueError, match="hang up"):
        await task


async def test_a_callback_without_a_guard_is_counted_by_the_loop() -> None:
    mistakes, loop = Mistakes(), asyncio.get_running_loop()
    before = loop.get_exception_handler()
    loop.set_exception_handler(mistakes.in_loop)
    try:
        loop.call_soon(lambda: 1 // 0)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
    finally:
        loop.set_exception_handler(before)
    assert mistakes.counts["callback"] == 1


def test_health_and_metrics_show_them_and_go_on_without_a_part_that_fails() -> None:
    monitor = Monitor(ProcessKind.SERVER, "Hall")
    assert monitor.alive_text() == "ok"

    def broken() -> list[object]:
        raise ValueError("no figures")

    monitor.add(broken)  # type: ignore[arg-type]
    body, _ = monitor.exposition()
    assert b"ua_fleet_ready" in body
    assert b'ua_fleet_mistakes_total{loop="metrics"} 1.0' in body
    assert monitor.alive_text().startswith("ok; 1 mistake since the start")
