"""Run the simulated robot; see the package."""

from __future__ import annotations

import argparse
import socket
import time
from collections.abc import Callable
from pathlib import Path

from ua_demo.simulators.tcp.command_line import CommandLine
from ua_demo.simulators.tcp.program import Program
from ua_demo.simulators.tcp.robot import Robot


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return host, int(port)


def _listen(address: tuple[str, int], serve: Callable[[socket.socket], None]) -> None:
    with socket.create_server(address) as listener:
        print("ready", listener.getsockname()[1], flush=True)
        while True:
            connection, _ = listener.accept()
            with connection:
                serve(connection)


def _connect(address: tuple[str, int], serve: Callable[[socket.socket], None]) -> None:
    print("ready", flush=True)
    while True:
        try:
            with socket.create_connection(address, timeout=5) as connection:
                connection.settimeout(None)
                serve(connection)
        except OSError:
            pass
        time.sleep(0.1)


def main() -> None:
    """Serve until the process is ended."""
    parser = argparse.ArgumentParser(prog="python -m ua_demo.simulators.tcp", description=__doc__)
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument("--listen", metavar="HOST:PORT", help="interpreter mode: the robot's program listens there")
    way.add_argument("--connect", metavar="HOST:PORT", help="interpreter mode: the robot's program connects to that")
    way.add_argument("--direct", metavar="HOST:PORT", help="direct mode: the robot takes commands there")
    parser.add_argument("--framing", choices=("terminator", "length", "acknowledged"), default="terminator")
    parser.add_argument("--terminator", default="\n", help="ends a field")
    parser.add_argument("--length", type=int, default=80, help="characters of a field with --framing length")
    parser.add_argument("--memory", type=Path, help="file in which the robot remembers what it was told")
    parser.add_argument("--ask", default="", metavar="ROBOT.DATA", help="data of another robot to ask for each second")
    options = parser.parse_args()
    robot = Robot(options.memory)
    if options.direct:
        command_line = CommandLine(robot)
        _listen(_address(options.direct), command_line.serve)
    program = Program(robot, options.framing, options.terminator.encode(), options.length, options.ask)
    if options.listen:
        _listen(_address(options.listen), program.serve)
    _connect(_address(options.connect), program.serve)


if __name__ == "__main__":
    main()
