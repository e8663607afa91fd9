"""From nothing to the demonstration: a fresh clone, `make demo`, until the console answers at the URL that it printed.

Packages come from the caches of pip and npm where those have them, and else from their registries, so the first run on
a machine measures its network too. It takes minutes and writes two environments, so it runs once, whatever the rounds.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

import httpx

from benchmarks.harness import Failed, Figure, Unavailable, within
from tests import system

GOAL_S: Final = 110.0
WAIT_S: Final = 600.0
END_S: Final = 60.0
_URL: Final = "http://127.0.0.1:"


def started_s(folder: Path) -> float:
    """Seconds from the clone until the console's page is there.

    Raises:
        Failed: it never was, with the last lines that were printed.
    """
    with ExitStack() as held:
        domains = [held.enter_context(system.ros_domain()) for _ in range(3)]
        port = system.free_tcp_port()
        options = [
            *("--port", str(system.free_tcp_port()), "--ros-master-port", str(system.free_tcp_port())),
            *("--console-port", str(port), "--pubsub-url", system.free_multicast_url()),
            *(word for domain in domains for word in ("--domain", str(domain))),
        ]
        began = time.monotonic()
        clone = folder / "clone"
        subprocess.run(["git", "clone", "--quiet", str(system.ROOT), str(clone)], check=True)
        command = ["make", "demo", "DEMO=talkrobots", f"ARGS=--wait {' '.join(options)}"]
        env = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}
        process = subprocess.Popen(
            command, cwd=clone, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, start_new_session=True,
        )  # fmt: skip
        lines: list[str] = []
        reading = threading.Thread(target=_read, args=(process, lines), daemon=True)
        reading.start()
        try:
            while not _answers(f"{_URL}{port}/", lines):
                if process.poll() is not None or time.monotonic() > began + WAIT_S:
                    raise Failed("no demonstration: " + " | ".join(line.strip() for line in lines[-5:]))
                time.sleep(0.1)
            return time.monotonic() - began
        finally:
            _end(process)


def _read(process: subprocess.Popen[str], lines: list[str]) -> None:
    assert process.stdout is not None
    lines.extend(process.stdout)


def _answers(url: str, lines: list[str]) -> bool:
    """Whether the page is at the URL, which has to be told before."""
    if not any(url in line for line in lines):
        return False
    with suppress(httpx.HTTPError):
        return httpx.get(url, timeout=5).status_code == 200
    return False


def _end(process: subprocess.Popen[str]) -> None:
    """As Ctrl-C does; what does not end then is killed."""
    for number in (signal.SIGINT, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(END_S)
            return


def figures(rounds: int) -> list[Figure]:
    for program in ("git", "make"):
        if shutil.which(program) is None:
            raise Unavailable(f"there is no {program} on this machine")
    if reason := system.missing("npm"):
        raise Unavailable(reason)
    with tempfile.TemporaryDirectory() as folder:
        return [within("from nothing to the console's page", started_s(Path(folder)), "s", GOAL_S)]
