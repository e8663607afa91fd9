"""Places for sessions: one user does not take them all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

from tests.attacks.harness import VICTIM, AttackedServer, attacked


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedServer]:
    with attacked(tmp_path_factory.mktemp("sessions")) as running:
        yield running


@pytest.mark.parametrize("user", ["olga", None])
def test_one_client_does_not_take_all_sessions(server: AttackedServer, user: str | None) -> None:
    """It took all 50, so that nobody else got in."""
    with server.harm() as harm, contextlib.ExitStack() as stack:
        clients = [stack.enter_context(server.connected()) for _ in range(60)]
        logins = [client.login(user) for client in clients[-20:]]
        assert logins == ["Good"] * 10 + ["BadTooManySessions"] * 10
        for other in ("oscar", "eva", None):
            stack.enter_context(server.logged_in(other, VICTIM))
    harm.check()


def test_places_are_kept_for_engineers(server: AttackedServer) -> None:
    with contextlib.ExitStack() as stack:
        logins: list[str] = []
        for number in range(6):
            clients = [stack.enter_context(server.connected(f"127.0.1.{number}")) for _ in range(9)]
            logins += [client.login(None) for client in clients]
        assert logins == ["Good"] * 40 + ["BadTooManySessions"] * 14
        stack.enter_context(server.logged_in("eva", VICTIM))
