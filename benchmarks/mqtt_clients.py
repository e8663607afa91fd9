"""MQTT client libraries at one mosquitto on loopback, beside a bare socket with packets that were made before.

Each library runs in a process of its own, in turn with the others, with at most 500 messages of 100 bytes in flight at
QoS 1: messages acknowledged in a second, messages heard in a second, and what it takes when the broker reads nothing.
A library that is not installed is left out; `MQTT_CLIENTS_PYTHON` names the Python of an environment that has them. The
one that we use has to reach a quarter of the bare socket. docs/adr/0072 says which one that is, and why.
"""

from __future__ import annotations

import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.harness import FEWEST_ROUNDS, Figure, Unavailable, shown
from tests.system import free_tcp_port, missing

PROGRAM = Path(__file__).parent / "_mqtt_client.py"
OURS = "mqttium"
LIBRARIES = (OURS, "gmqtt", "zmqtt", "aiomqtt", "awscrt", "pymosquitto")
MESSAGES = 10_000
STALLED = 50_000
GOAL = 0.25
CONFIGURATION = """\
listener {port} 127.0.0.1
allow_anonymous true
max_inflight_messages 0
max_queued_messages 0
persistence false
"""


def python() -> str:
    return os.environ.get("MQTT_CLIENTS_PYTHON", sys.executable)


def is_installed(library: str) -> bool:
    return subprocess.run([python(), "-c", f"import {library}"], capture_output=True, check=False).returncode == 0


@contextmanager
def broker() -> Generator[int]:
    port = free_tcp_port()
    with tempfile.TemporaryDirectory() as folder:
        configuration = Path(folder) / "mosquitto.conf"
        configuration.write_text(CONFIGURATION.format(port=port))
        process = subprocess.Popen(["mosquitto", "-c", configuration], stderr=subprocess.DEVNULL)
        try:
            wait_for(port)
            yield port
        finally:
            process.terminate()
            process.wait()


def wait_for(port: int) -> None:
    deadline = time.monotonic() + 10
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        if time.monotonic() > deadline:
            raise Unavailable("mosquitto does not listen after 10 s")
        time.sleep(0.02)


def start(library: str, scenario: str, port: int, count: int) -> subprocess.Popen[str]:
    # -P: else the `json` that it imports would be the group of that name beside it.
    arguments = [python(), "-P", str(PROGRAM), library, scenario, str(port), str(count)]
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def result(process: subprocess.Popen[str]) -> dict[str, Any] | None:
    try:
        output, _ = process.communicate(timeout=90)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return None
    lines = [line for line in output.splitlines() if line.startswith("{")]
    return json.loads(lines[-1]) if lines else None


def published(library: str, port: int) -> dict[str, Any] | None:
    return result(start(library, "publish", port, MESSAGES))


def received(library: str, port: int) -> dict[str, Any] | None:
    process = start(library, "receive", port, MESSAGES)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("ready"):
            sender = start("socket", "publish", port, MESSAGES)
            heard = result(process)
            result(sender)
            return heard
    process.wait()
    return None


@contextmanager
def stalled_broker() -> Generator[int]:
    """Accepts, says that the connection is there, and reads nothing after CONNECT."""
    server = socket.create_server(("127.0.0.1", 0))
    kept: list[socket.socket] = []

    def serve() -> None:
        while True:
            try:
                accepted, _ = server.accept()
            except OSError:
                return
            kept.append(accepted)
            connect = accepted.recv(4096)
            is_5 = connect[connect.index(b"MQTT") + 4] == 5
            accepted.sendall(b"\x20\x03\x00\x00\x00" if is_5 else b"\x20\x02\x00\x00")

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield server.getsockname()[1]
    finally:
        server.close()
        for accepted in kept:
            accepted.close()


def stalled(library: str) -> dict[str, Any] | None:
    with stalled_broker() as port:
        return result(start(library, "stalled", port, STALLED))


def middle(results: list[dict[str, Any]], key: str) -> float:
    return statistics.median(float(each[key]) for each in results)


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    if problem := missing("mosquitto"):
        raise Unavailable(problem)
    libraries = [library for library in LIBRARIES if is_installed(library)]
    measured: dict[tuple[str, str], list[dict[str, Any]]] = {}
    with broker() as port:
        for _ in range(rounds):
            for library in ("socket", *libraries):
                for scenario, measure in (("publish", published), ("receive", received)):
                    if (each := measure(library, port)) is not None:
                        measured.setdefault((library, scenario), []).append(each)
    found: list[Figure] = []
    for scenario, what in (("publish", "acknowledged"), ("receive", "heard")):
        floor = middle(measured["socket", scenario], "per_second")
        for library in libraries:
            results = measured.get((library, scenario))
            if not results:
                continue
            value = middle(results, "per_second")
            goal = GOAL if library == OURS else None
            name, unit, ratio = f"{library}: QoS 1, {what}", "1/s", value / floor
            holds = goal is None or ratio >= goal
            found.append(Figure(name, value, unit, "bare socket", floor, ratio, goal, holds))
            cpu, least = middle(results, "cpu_us"), middle(measured["socket", scenario], "cpu_us")
            found.append(
                shown(f"{library}: processor, {what}", cpu, "us", reference="bare socket", reference_value=least)
            )
    for library in libraries:
        if (each := stalled(library)) is not None:
            name = f"{library}: {each['done']} messages of 1 kB taken for a broker that reads nothing, memory"
            taken_mb = each["done"] / 1000
            found.append(shown(name, each["memory_mb"], "MB", reference="their bytes", reference_value=taken_mb))
    return found
