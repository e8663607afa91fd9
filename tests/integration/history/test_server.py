"""A whole server with its history in PostgreSQL."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import ENGINEER, ROBOTS, fleet_config, reader, serving, ua, until
from tests.integration.server_model.test_event_history import events_of, of_type, reading, selecting
from tests.integration.server_model.test_history import ask, raw, shows, values_of
from tests.postgres import PASSWORD, USER, Postgres
from ua_fleet.errors import StorageUnavailable

pytestmark = pytest.mark.needs("postgres")
GOAL = "ns=2;i=1002"


def config_of(udp_url: str, tcp_port: int, url: str) -> Any:
    history = {"store": url, "user": USER, "password_file": "secrets/history"}
    return fleet_config(udp_url, tcp_port, robots=ROBOTS, history=history)


def write_password(folder: Path, text: str, mode: int = 0o600) -> None:
    file = folder / "secrets" / "history"
    file.parent.mkdir(exist_ok=True)
    file.write_text(text)
    file.chmod(mode)


async def test_values_and_continuation_points_outlast_a_restart(
    postgres: Postgres, udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    write_password(tmp_path, f"{PASSWORD}\n")
    begin = datetime.now(UTC)
    with postgres.database("server_model") as url:
        async with serving(tmp_path, config_of(udp_url, tcp_port, url)) as running, running.client() as client:
            for value in (0.25, 0.5, 0.75):
                await client.get_node(GOAL).write_value(value)
                await until(reader(client, GOAL), shows(value))
            [page] = await ask(client, raw(begin, None, 2), GOAL)
            assert len(values_of(page)) == 2
        found = values_of(page)
        async with serving(tmp_path, config_of(udp_url, tcp_port, url)) as running, running.client() as client:
            while page.ContinuationPoint:
                [page] = await ask(client, raw(begin, None, 2), GOAL, point=page.ContinuationPoint)
                page.StatusCode.check()
                found += values_of(page)
            written = selecting("NewValue", where=[of_type(ua.ObjectIds.AuditWriteUpdateEventType)])
            assert await events_of(client, reading(evfilter=written)) == []
            async with running.client(ENGINEER) as engineer:
                assert await events_of(engineer, reading(evfilter=written)) == [[0.25], [0.5], [0.75]]
        assert [value for value in found if value][:3] == [0.25, 0.5, 0.75]
    assert not (tmp_path / "state" / "history.db").exists()


@pytest.mark.parametrize(
    ("text", "mode", "said"),
    [
        ("wrong", 0o600, "password authentication failed"),
        (PASSWORD, 0o644, "others may read"),
        ("\n", 0o600, "is empty"),
        (None, 0o600, "No such file"),
    ],
)
async def test_a_server_that_may_not_use_the_database_does_not_start(
    postgres: Postgres, udp_url: str, tcp_port: int, tmp_path: Path, text: str | None, mode: int, said: str
) -> None:
    if text is not None:
        write_password(tmp_path, text, mode)
    with pytest.raises(StorageUnavailable, match=said) as refused:
        async with serving(tmp_path, config_of(udp_url, tcp_port, postgres.url())):
            pass
    assert "history.password_file" in str(refused.value)


async def test_a_server_starts_while_its_database_is_away(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    """Values are shown, the history has none yet, and its nodes are as ever; then the database comes."""
    write_password(tmp_path, PASSWORD)
    with Postgres() as own:
        own.kill()
        async with serving(tmp_path, config_of(udp_url, tcp_port, own.url())) as running, running.client() as client:
            await client.get_node(GOAL).write_value(0.25)
            await until(reader(client, GOAL), shows(0.25))
            begin = datetime.now(UTC) - timedelta(minutes=1)
            [page] = await ask(client, raw(begin, None, 10), GOAL)
            assert page.StatusCode.name == "BadDataUnavailable"
            await asyncio.to_thread(own.start)
            for _ in range(600):
                [page] = await ask(client, raw(begin, None, 10), GOAL)
                if page.StatusCode.is_good():
                    break
                await asyncio.sleep(0.1)
            assert 0.25 in values_of(page)
