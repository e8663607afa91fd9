"""`ua-fleet up`: all processes of a fleet in one terminal, started, told of and ended together."""

from __future__ import annotations

import os
import pty
import shutil
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.cli.conftest import PASSWORD, command
from tests.system import Child, Processes, clean_environment, forked, free_multicast_url, free_tcp_port
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

FLEET = """\
version: 1
fleet: {{name: Hall}}
server: {{port: {port}}}
pubsub:
  security: sign_and_encrypt
  url: {url}
bridges:
  press: {{kind: tcp, space: 310, status_id: 1900, interpreter: {{connect: "127.0.0.1:1"}}}}
  saw: {{kind: tcp, space: 311, status_id: 1901, interpreter: {{connect: "127.0.0.1:1"}}}}
  old: {{kind: ros1, status_id: 1902}}
"""


class Fleet:
    """A folder with a fleet of two bridges that run anywhere, and one that needs ROS 1."""

    def __init__(self, folder: Path, processes: Processes) -> None:
        self.folder, self.port, self._processes = folder, free_tcp_port(), processes
        (folder / "fleet.yaml").write_text(FLEET.format(port=self.port, url=free_multicast_url()))

    @property
    def endpoint(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.port}/ua_fleet"

    @property
    def environment(self) -> dict[str, str]:
        return clean_environment(
            UA_FLEET_CONFIG=str(self.folder / "fleet.yaml"),
            XDG_STATE_HOME=str(self.folder / "home"),
            UA_FLEET_ROS1_PYTHON="/nowhere/python",
        )

    def start(self, *arguments: str) -> Child:
        return self._processes.start(*command(*arguments), env=self.environment)


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    with Processes() as processes:
        yield Fleet(tmp_path, processes)


def children_of(child: Child) -> list[int]:
    """What it runs. Beside these it has the process that these are forked off."""
    pid = child.process.pid
    pids = [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [one for one in pids if {"serve", "bridge"} & set(words_of(one))]


def are_gone(pids: list[int]) -> bool:
    """Whether none of them runs; who has no parent may lie there until somebody asks for its end."""
    stats = [Path(f"/proc/{pid}/stat") for pid in pids]
    return all(not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z" for stat in stats)


def words_of(pid: int) -> list[str]:
    """A process's command line."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")


def named(child: Child, text: str) -> int:
    """The process whose command line has this."""
    for pid in children_of(child):
        if text in words_of(pid):
            return pid
    raise AssertionError(f"no process has {text}")


def test_all_of_a_fleet_comes_up_is_told_of_and_ends_with_ctrl_c(fleet: Fleet) -> None:
    state = fleet.folder / "state"
    state.mkdir(mode=0o700)
    UserStore(state / USERS_FILE, ScryptCost(2**8, 8, 1)).add("anna", PASSWORD, Role.OPERATOR)
    up = fleet.start("up")
    up.wait_for(f"server | ready: {fleet.endpoint}")
    up.wait_for(f"endpoint: {fleet.endpoint}")
    up.wait_for(f"users: anna (operator); in another terminal: ua-fleet login {fleet.endpoint} --user anna")
    up.wait_for("press  | ready: bridge press")
    up.wait_for("saw    | ready: bridge saw")
    up.wait_for("bridge old is not started: it needs rospy")
    # They needed certificates, and have keys.
    assert any("bridge press has a certificate now" in line for line in up.lines)
    pids = children_of(up)
    assert len(pids) == 3

    press = named(up, "press")
    os.kill(press, signal.SIGKILL)
    up.wait_for("bridge press was ended by SIGKILL")
    up.wait_for("to start it again, in another terminal: ua-fleet bridge press")
    assert len(children_of(up)) == 2

    assert up.end(signal.SIGINT) == 130
    assert are_gone(pids)
    assert not any("Traceback" in line or "bridge saw " in line.partition(" | ")[0] for line in up.lines[-20:])
    assert all(line.partition(" |")[0].strip() in ("server", "press", "saw") for line in up.lines if " | " in line)


def test_a_bridge_that_ends_is_told_with_its_reason_and_the_others_go_on(fleet: Fleet) -> None:
    first = fleet.start("up", "press")
    first.wait_for("press  | ready: bridge press")
    first.wait_for("no user exists yet; in another terminal: ua-fleet user add NAME --role operator")
    # A second one has no place: its server says so, and it ends as that does.
    second = fleet.start("up")
    second.wait_for("a server of")
    second.wait_for("runs already")
    assert second.process.wait(60) == 1
    os.kill(named(first, "serve"), signal.SIGKILL)
    first.wait_for("the server was ended by SIGKILL, and the bridges with it")
    assert first.process.wait(60) != 0

    alone = fleet.start("bridge", "press")
    alone.wait_for("bridge press")
    up = fleet.start("up", "press", "saw")
    up.wait_for("bridge press ended with code 1: ua-fleet: ")
    assert any("bridge press runs already" in line for line in up.lines)
    up.wait_for("saw    | ready: bridge saw")
    assert up.end(signal.SIGTERM) == 130


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv (util-linux) is missing")
def test_children_end_with_one_that_is_killed(fleet: Fleet) -> None:
    up = fleet.start("up", "press")
    up.wait_for("press  | ready: bridge press")
    pids = children_of(up)
    up.process.kill()
    up.process.wait()
    deadline = time.monotonic() + 20
    while not are_gone(pids):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_what_is_not_there_is_told(fleet: Fleet) -> None:
    unknown = fleet.start("up", "attic")
    unknown.wait_for("there is no bridge or relay 'attic'; there are: press, saw, old")
    assert unknown.process.wait(60) == 3
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", fleet.port))
        taken.listen()
        up = fleet.start("up")
        up.wait_for("cannot listen")
        assert up.process.wait(60) == 1


def test_names_are_coloured_on_a_terminal(fleet: Fleet) -> None:
    ours, theirs = pty.openpty()
    environment = {name: value for name, value in fleet.environment.items() if name != "NO_COLOR"}
    up = forked(*command("up", "press"), env=environment, terminal=theirs)
    os.close(theirs)
    said = b""
    while b"| ready: bridge press" not in said.replace(b"\x1b[0m", b""):
        said += os.read(ours, 65536)
    up.send_signal(signal.SIGINT)
    try:
        while chunk := os.read(ours, 65536):
            said += chunk
    except OSError:  # the end of the other side is an error where it is a terminal
        pass
    os.close(ours)
    assert up.wait(20) == 130
    assert b"\x1b[36mserver |\x1b[0m " in said
    assert b"\x1b[33mpress  |\x1b[0m ready: bridge press" in said
    assert b"Traceback" not in said


def test_all_of_it_ends_where_nobody_reads_what_it_tells(fleet: Fleet) -> None:
    up = forked(*command("up", "press"), env=fleet.environment)
    up.stdout.close()
    try:
        assert up.wait(30) == 1
    finally:
        up.kill()
        up.wait()
        up.close()
