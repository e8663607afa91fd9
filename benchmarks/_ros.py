"""Processes and graphs of the ROS benchmarks."""

from __future__ import annotations

import contextlib
import json
import subprocess
import tempfile
import time
from collections.abc import Generator, Mapping
from pathlib import Path

from benchmarks.harness import Failed
from tests import system

__all__ = ["NODES", "RUNNER", "Node", "median_and_p99", "ros1_environment", "running_master", "running_node"]

NODES = Path(__file__).parent / "ros_nodes"
RUNNER = system.ROOT / "tests" / "integration" / "run_bridge.py"


class Node:
    """A process that is told what to do by lines."""

    def __init__(self, *args: str | Path, env: Mapping[str, str], cwd: Path = system.ROOT) -> None:
        self._complaints = tempfile.TemporaryFile("w+")  # noqa: SIM115 - as long as the process
        self._process = subprocess.Popen(
            [str(arg) for arg in args],
            env=dict(env),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            text=True,
            start_new_session=True,
            cwd=cwd,
        )
        self._name = " ".join(str(arg) for arg in args[1:3])
        self.ready = self.expect("ready")

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self._process.pid

    def read(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise Failed(f"{self._name} ended with code {self._process.wait()}: {self._last_complaint()}")
        return line.strip()

    def _last_complaint(self) -> str:
        self._complaints.seek(0)
        return (self._complaints.read().strip().splitlines() or ["it did not say why"])[-1]

    def expect(self, text: str) -> str:
        while not (line := self.read()).startswith(text):
            pass
        return line

    def tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def ages(self) -> list[float]:
        """The ages (microseconds) that the process has noted since it was last asked."""
        ages: list[float] = json.loads(self.read())
        return ages

    def end(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.terminate()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
        self._complaints.close()


@contextlib.contextmanager
def running_node(*args: str | Path, env: Mapping[str, str], cwd: Path = system.ROOT) -> Generator[Node]:
    """A process while the context lasts."""
    node = Node(*args, env=env, cwd=cwd)
    try:
        yield node
    finally:
        node.end()


def ros1_environment(folder: Path) -> dict[str, str]:
    """The environment of a ROS 1 graph of its own."""
    return system.clean_environment(
        ROS_IP="127.0.0.1", ROS_LOG_DIR=str(folder), ROS_MASTER_URI=f"http://127.0.0.1:{system.free_tcp_port()}"
    )


@contextlib.contextmanager
def running_master(env: Mapping[str, str]) -> Generator[None]:
    """The master of that graph."""
    port = env["ROS_MASTER_URI"].rpartition(":")[2]
    master = subprocess.Popen(
        ["/usr/bin/rosmaster", "--core", "-p", port, "-w", "3"],
        env=dict(env),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        time.sleep(0.5)
        yield
    finally:
        master.terminate()
        master.wait()


def median_and_p99(ages: list[float]) -> tuple[float, float]:
    """Of one round's ages."""
    if not ages:
        raise Failed("nothing arrived")
    ordered = sorted(ages)
    return ordered[len(ordered) // 2], ordered[len(ordered) * 99 // 100]
