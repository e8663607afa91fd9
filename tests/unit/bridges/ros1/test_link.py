"""A link to a publisher that is made of plain sockets. Needs no ROS."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import pytest
from ua_bridges.ros1 import link as links
from ua_bridges.ros1.link import Link
from ua_bridges.ros1.tcpros import Broken, ask, is_there, topic_address

from tests.attacks.ros1_publisher import HostilePublisher, Serve, endless, header, message, say, silent

TOPIC = "/ua_1_2_7"


class Owner:
    """Keeps what a link tells."""

    def __init__(self, heard: Exception | None = None) -> None:
        self.header: dict[str, str] | None = None
        self.contents: list[bytes] = []
        self.offence: str | None = None
        self.ended = threading.Event()
        self.has_heard = threading.Event()
        self._error = heard

    def link_up(self, link: Link) -> None:
        self.header = link.header

    def link_heard(self, link: Link, content: bytes) -> None:
        self.contents.append(content)
        self.has_heard.set()
        if self._error is not None:
            raise self._error

    def link_ended(self, link: Link, offence: str | None) -> None:
        self.offence = offence
        self.ended.set()


class Publisher(HostilePublisher):
    """One that no master knows."""

    def __init__(self, serve: Serve) -> None:
        super().__init__("", TOPIC, serve)

    def call_master(self, method: str, *args: str) -> Any:
        return None


@contextmanager
def linked(serve: Serve, owner: Owner) -> Generator[Link]:
    with Publisher(serve) as publisher:
        link = Link(TOPIC, publisher.uri, "/ua_bridge", owner)
        link.start()
        yield link
        link.close()
        link.join(5)


def test_messages_come_as_they_are_sent_whatever_their_size() -> None:
    contents = [b"", b"x", b"y" * (3 << 20), b"z"]
    owner = Owner()
    with linked(lambda link: link.sendall(header() + b"".join(map(message, contents))), owner):
        assert owner.ended.wait(10)
    assert owner.contents == contents
    assert owner.header is not None
    assert owner.header["type"] == "std_msgs/Float64"
    assert owner.offence is None  # it went


@pytest.mark.parametrize(
    ("serve", "offence"),
    [
        (say(header({"md5sum": "*"})), "has no `type`"),
        (say(header({"type": "*"})), "has no `md5sum`"),
        (say(struct.pack("<I", 0)), "has no `type`"),
        (endless(b"\xff\xff\xff\xff", again=b"x" * 65536), "has 4294967295 bytes"),
        (say(struct.pack("<II", 8, 900) + b"type"), "longer than the header"),
        (say(struct.pack("<II", 8, 4) + b"type"), "has no `=`"),
        (say(struct.pack("<I", 3) + b"abc"), "within a length"),
        (endless(header(), b"\xff\xff\xff\xff", again=b"x" * 65536), "a message of 4294967295 bytes"),
        (silent, "in time"),
        (endless(b"\x00", again=b"", pause_s=0.1), "in time"),
        (endless(struct.pack("<I", 60000), again=b"x", pause_s=0.1), "in time"),
    ],
)
def test_what_no_publisher_does_is_told_and_ends_the_link(
    serve: Serve, offence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "HANDSHAKE_S", 1.0)
    owner = Owner()
    with linked(serve, owner):
        assert owner.ended.wait(10)
    assert offence in str(owner.offence)


def test_a_refusal_and_an_absent_publisher_are_no_offence() -> None:
    owner = Owner()
    with linked(say(header({"error": "no"})), owner):
        assert owner.ended.wait(10)
    assert owner.offence is None
    owner = Owner()
    link = Link(TOPIC, "http://127.0.0.1:1/", "/ua_bridge", owner)
    link.start()
    assert owner.ended.wait(10)
    assert owner.offence is None


def test_a_mistake_of_ours_costs_the_link_and_is_an_offence() -> None:
    owner = Owner(heard=KeyError("a mistake of the bridge"))
    with linked(say(header(), message(b"x")), owner):
        assert owner.ended.wait(10)
    assert "mistake of the bridge (KeyError)" in str(owner.offence)


def test_a_link_that_is_closed_by_us_ends_soon() -> None:
    owner = Owner()
    with linked(say(header(), message(b"x")), owner) as link:
        assert owner.has_heard.wait(10)
        link.close()
        assert owner.ended.wait(10)
    assert owner.offence is None


def http(body: bytes, length: int | None = None) -> bytes:
    size = b"" if length is None else b"Content-Length: %d\r\n" % length
    return b"HTTP/1.0 200 OK\r\n" + size + b"\r\n" + body


BOMB = b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "x">]><methodResponse/>'
WIDE_BOMBS = [BOMB.decode().replace("?>", f' encoding="{name}"?>').encode(name) for name in ("utf-16", "utf-16-be")]


@pytest.mark.parametrize(
    ("serve", "reason"),
    [
        (silent, "in time"),
        (say(b"HTTP/1.0 200 OK\r\n\r\n"), "how long"),
        (say(http(b"", 1 << 30)), "too long"),
        (endless(again=b"x" * 65536), "longer than"),
        *[(say(http(bomb, len(bomb))), "declarations") for bomb in (BOMB, *WIDE_BOMBS)],
        (say(http(b"<methodResponse>", 16)), "no answer"),
        (say(http(b"", 0)), "no answer"),
    ],
)
def test_an_answer_that_is_none_is_refused_in_time(serve: Serve, reason: str) -> None:
    with Publisher(serve) as publisher:
        port = publisher.listener.getsockname()[1]
        started = time.monotonic()
        with pytest.raises(Broken, match=reason):
            ask(f"http://127.0.0.1:{port}/", "getPid", ("/test",), started + 1.0)
        assert is_there(f"http://127.0.0.1:{port}/", "/test")


@pytest.mark.parametrize(
    "uri", ["", "http://", "http://127.0.0.1", "http://127.0.0.1:99999/", "http://[::1", "x" * 999]
)
def test_an_address_that_is_none_is_refused(uri: str) -> None:
    with pytest.raises(Broken, match="no URI"):
        ask(uri, "getPid", ("/test",), time.monotonic() + 1.0)


@pytest.mark.parametrize(
    "answer", ["x", [], ["UDPROS", "127.0.0.1", 1], ["TCPROS", 1, 1], ["TCPROS", "x", 0], ["TCPROS", "x"]]
)
def test_a_way_to_a_topic_that_is_none_is_refused(answer: Any) -> None:
    with Publisher(silent) as publisher:
        answered: Callable[..., Any] = lambda *_: [1, "", answer]  # noqa: E731 - typed for pyright
        publisher.api.register_function(answered, "requestTopic")
        with pytest.raises(Broken, match="no way that is known"):
            topic_address(publisher.uri, "/test", TOPIC, time.monotonic() + 5)
