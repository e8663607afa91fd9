"""A robot that misbehaves on one of its connections costs that one; the other is read all the time."""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from typing import NamedTuple

import pytest
from ua_bridges.tcp.driver import create_driver

from tests.attacks.servers import Serve, endless, goes_on, hostile, silent, slow
from tests.contract.harness import Recorder
from tests.waiting import until
from ua_fleet.config.load import load_content
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

FLEET = """
version: 1
pubsub: {security: none}
bridges:
  cell:
    kind: tcp
    space: 300
    status_id: 1
    interpreter: {connect: "127.0.0.1:PROGRAM", encoding: utf-8, answer_timeout_s: 1}
    direct: {connect: "127.0.0.1:DIRECT", language: plain}
robots:
  arm:
    bridge: cell
    data:
      text: {id: 10, type: String}
      count: {id: 11, type: Double, source: {direct: {line: "COUNT {value}"}}}
"""
TEXT, COUNT = Topic(300, 2, 10), Topic(300, 2, 11)
INFORMATION = b"information\ntext\n0\n1\nhello\n"


def counting(link: socket.socket) -> None:
    """An honest controller."""
    while True:
        link.sendall(b"COUNT %f\n" % time.monotonic())
        time.sleep(0.02)


def telling(link: socket.socket) -> None:
    """An honest program."""
    while True:
        link.sendall(b"information\ntext\n0\n1\n%f\n" % time.monotonic())
        time.sleep(0.02)


def say(content: bytes) -> Serve:
    """Say that once, and then nothing."""

    def serve(link: socket.socket) -> None:
        link.sendall(content)
        silent(link)

    return serve


def vanishing(link: socket.socket) -> None:
    """Go at once."""


def deaf(link: socket.socket) -> None:
    """Ask without end, and read no answer."""
    while True:
        link.sendall(b"request\nother.value\n1\n0\n" * 1000)


def changing(link: socket.socket) -> None:
    """Each message has another number of fields, or another type."""
    number = 0
    while True:
        number += 1
        link.sendall(b"information\ntext\n0\n%d\n" % (number % 5) + b"x\n" * (number % 5))


TO_PROGRAM: dict[str, tuple[Serve, str]] = {
    "silent": (silent, ""),
    "endless": (endless(b"x" * 65536), "a field of more than"),
    "no_text": (say(b"\xff\xfe\n"), "not utf-8"),
    "orders_for_a_terminal": (say(b"information\n\x1b[2J\n"), "control characters"),
    "no_message": (endless(b"\n" * 65536), "it sent"),
    "a_count_that_is_a_lie": (say(b"information\ntext\n0\n4294967295\n"), "it sent"),
    "slow": (slow(INFORMATION[:9]), "in the middle of a message"),
    "changing": (changing, ""),
    "flooding": (endless(INFORMATION * 2000), ""),
    "deaf": (deaf, ""),
    "vanishing": (vanishing, ""),
}
TO_DIRECT: dict[str, tuple[Serve, str]] = {
    "silent": (silent, ""),
    "endless": (endless(b"x" * 65536), "a line without end"),
    "no_text": (endless(b"COUNT \xff\xfe\n" * 1000), ""),
    "nothing_but_ends_of_lines": (endless(b"\n" * 65536), ""),
    "numbers_that_are_none": (endless(b"COUNT 1e999\nCOUNT nan\nCOUNT " + b"9" * 3000 + b"\n"), ""),
    "slow": (slow(b"COUNT 1\n" * 10), ""),
    "flooding": (endless(b"COUNT 1\n" * 8000), ""),
    "vanishing": (vanishing, ""),
}


class Damage(NamedTuple):
    """What an attack has cost."""

    aside: list[str]
    """What is put aside."""
    is_counted: bool
    """Whether a message was dropped for that."""
    lost: int
    """How often the honest source was."""
    is_over: bool
    """Whether the bridge's driver has ended."""


async def attacked(program: Serve, direct: Serve, honest: Topic, name: str, offence: str) -> Damage:
    """Attack a driver with an honest source beside it; where it is an offence, until somebody is put aside for it."""
    with hostile(program) as program_port, hostile(direct) as direct_port:
        text = FLEET.replace("PROGRAM", str(program_port)).replace("DIRECT", str(direct_port))
        driver, recorder = create_driver(load_content(text.encode(), "f.yaml", {}), "cell"), Recorder()
        await driver.start(recorder)
        try:
            await until(lambda: recorder.samples(honest), "the honest value")
            await goes_on(recorder, honest, 1.5)
            if offence:
                await until(lambda: offence in driver.status().aside.get(name, ""), "that it is put aside")
            status = driver.status()
            return Damage(
                list(status.aside), bool(recorder.dropped(Drop.MISBEHAVED)), recorder.lost(honest), status.is_over
            )
        finally:
            with suppress(OSError):
                await driver.stop()


@pytest.mark.parametrize("kind", TO_PROGRAM)
async def test_a_program_that_misbehaves_costs_itself(kind: str) -> None:
    serve, offence = TO_PROGRAM[kind]
    damage = await attacked(serve, counting, COUNT, "cell (interpreter)", offence)
    assert damage.aside == (["cell (interpreter)"] if offence else [])
    assert damage.is_counted or not offence
    assert (damage.lost, damage.is_over) == (0, False)


@pytest.mark.parametrize("kind", TO_DIRECT)
async def test_a_controller_that_misbehaves_costs_itself(kind: str) -> None:
    serve, offence = TO_DIRECT[kind]
    damage = await attacked(telling, serve, TEXT, "cell (direct)", offence)
    assert damage.aside == (["cell (direct)"] if offence else [])
    assert damage.is_counted or not offence
    assert (damage.lost, damage.is_over) == (0, False)
