from __future__ import annotations

import socket
from collections.abc import Generator
from contextlib import ExitStack
from typing import Any

import pytest
from ua_bridges.ur import link
from ua_bridges.ur.library.child import ChildFailed, NoAnswer
from ua_bridges.ur.link import CommandLink

from tests.ur_controller import free_loopback
from ua_fleet.errors import RobotOffline, SkillError, SkillFailed, SkillTimeout


@pytest.fixture
def deaf_host() -> Generator[str]:
    """Its port 30002 is behind a firewall, as it seems: the first packet of a connection is never answered."""
    host = free_loopback()
    with ExitStack() as stack:
        listener = stack.enter_context(socket.create_server((host, 30002), backlog=0))
        while True:
            try:
                stack.enter_context(socket.create_connection(listener.getsockname(), 0.1))
            except TimeoutError:
                break
        yield host


def test_program_that_could_not_be_sent_is_told_with_the_port(deaf_host: str) -> None:
    with pytest.raises(RobotOffline, match="port 30002: timed out; see that"):
        CommandLink(deaf_host, 0.2).send_script("def p():\nend\n")


class Child:
    """A child that ends, or answers, as the test says."""

    has_ended = False
    start: Exception | None = None
    heard: Exception | None = None
    answer: Any = None

    def __init__(self, *_: str) -> None:
        if self.start is not None:
            raise self.start

    def say(self, _thing: Any) -> None:
        if self.heard is not None:
            raise self.heard

    def line(self, _timeout_s: float) -> Any:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def end(self) -> None:
        pass


@pytest.mark.parametrize(
    ("what", "error"),
    [
        ({"start": ChildFailed("no place for a process")}, RobotOffline),
        ({"heard": ChildFailed("it has ended")}, RobotOffline),
        ({"answer": {"error": "Failed to execute: play", "refused": True}}, SkillFailed),
        ({"answer": {"error": "read_until: End of file", "refused": False}}, SkillTimeout),
        ({"answer": NoAnswer("no answer within 3 s")}, SkillTimeout),
        ({"answer": ChildFailed("it has ended")}, SkillTimeout),
    ],
)
def test_only_what_was_not_said_was_not_begun(
    monkeypatch: pytest.MonkeyPatch, what: dict[str, Any], error: type[SkillError]
) -> None:
    monkeypatch.setattr(link, "LibraryChild", type("Played", (Child,), what))
    with pytest.raises(error):
        CommandLink("127.0.0.9", 0.1).call("control", "moveJ")
