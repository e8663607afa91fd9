"""The nine tasks as a user starts them, for tests."""

from __future__ import annotations

import json
import sys
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tests.system import Child, Processes, free_multicast_url, free_tcp_port, ros_domain

__all__ = ["Demonstration", "demonstration"]


class Demonstration:
    """A command that runs, and what it writes."""

    def __init__(self, child: Child, folder: Path) -> None:
        self.child, self.folder = child, folder

    def finish(self, timeout_s: float) -> dict[str, Any]:
        """Wait for its end, which has to be a success; the report."""
        code = self.child.process.wait(timeout_s)
        self.child.end()
        assert code == 0, "\n".join(self.child.lines)
        report: dict[str, Any] = json.loads((self.folder / "report.json").read_text())
        return report

    def printed(self, label: str) -> str:
        """The word after a label in what it has printed."""
        line = self.child.wait_for(label, timeout_s=120)
        return line.partition(label)[2].split()[0].rstrip(",")


@contextmanager
def demonstration(
    processes: Processes, folder: Path, *options: str, pubsub_urls: Sequence[str] = ()
) -> Generator[Demonstration]:
    """`ua-fleet demo talkrobots --once`, on ports, a group (if not at these addresses) and domains of its own."""
    with ExitStack() as held:
        domains = [held.enter_context(ros_domain()) for _ in range(3)]
        command = [
            *(sys.executable, "-m", "ua_fleet.cli", "demo", "talkrobots", "--once"),
            *("--json", str(folder / "report.json"), "--folder", str(folder / "run")),
            *("--port", str(free_tcp_port()), "--ros-master-port", str(free_tcp_port())),
            *("--console-port", str(free_tcp_port())),
            *(word for url in pubsub_urls or [free_multicast_url()] for word in ("--pubsub-url", url)),
            *(word for domain in domains for word in ("--domain", str(domain))),
            *options,
        ]
        yield Demonstration(processes.start(*command), folder)
