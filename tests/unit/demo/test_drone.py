"""The drone's program: of two connections the newest counts, since nobody ends one that was cut."""

from __future__ import annotations

import importlib.util
import socket
import threading
from typing import Any

import pytest
from ua_demo.talkrobots.setting import ROBOTS

GREETING = b"information\nflying_state\n0\n1\nlanded\n"


def read(link: socket.socket, size: int) -> bytes:
    link.settimeout(30)
    found = b""
    while len(found) < size and (more := link.recv(size - len(found))):
        found += more
    return found


@pytest.fixture
def drone() -> Any:
    spec = importlib.util.spec_from_file_location("drone", ROBOTS / "drone.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_connection_that_was_cut_does_not_keep_the_next_one_waiting(
    drone: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    ours = drone.Drone("quadcopter", 1000.0)
    links: list[socket.socket] = []
    threads: list[threading.Thread] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        for _ in range(2):
            links.append(socket.create_connection(listener.getsockname()))
            threads.append(threading.Thread(target=drone.serve_until_over, args=(ours, listener.accept()[0])))
            threads[-1].start()
            assert read(links[-1], len(GREETING)) == GREETING
    cut, newest = links
    assert read(cut, 1) == b"", "the program has ended it"
    newest.sendall(b"command\ntake_off\n7\n0\n")
    told = b"status\nrunning\n7\n0\n"
    assert read(newest, len(told)) == told
    assert '"quadcopter"' in capsys.readouterr().out
    newest.close()
    for thread in threads:
        thread.join(30)
        assert not thread.is_alive()
    cut.close()
