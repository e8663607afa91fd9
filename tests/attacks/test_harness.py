"""The measure itself: it sees no harm where there is none, and each kind of harm."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.attacks.harness import AttackedServer, attacked, ua
from tests.waiting import until


@pytest.fixture
def server(tmp_path: Path) -> Iterator[AttackedServer]:
    with attacked(tmp_path) as running:
        yield running


async def test_a_server_at_rest_is_not_harmed(server: AttackedServer) -> None:
    with server.harm() as harm:
        await until(lambda: harm.victim.reads > 5)
        with server.logged_in("olga") as client:
            request = ua.ReadRequest()
            request.Parameters.NodesToRead = [ua.ReadValueId(ua.NodeId(2259), ua.AttributeIds.Value)]
            assert client.call(request, ua.ReadResponse).Results[0].Value.Value == 0
    harm.check()
    assert any(line["event"] == "login" and line["user"] == "olga" for line in server.audit())


async def test_an_ended_server_is_harm(server: AttackedServer) -> None:
    with server.harm() as harm:
        server.process.process.send_signal(signal.SIGKILL)
        server.process.process.wait()
        await until(lambda: harm.victim.failure, "the victim's failure")
    with pytest.raises(AssertionError, match="the server has ended; the victim lost its session"):
        harm.check()
