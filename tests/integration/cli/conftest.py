"""A server that was set up and started with the command line alone, and the command line as its client."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pytest

from tests.system import Child, Processes, clean_environment, free_multicast_url, free_tcp_port, run

PASSWORD: Final = "open sesame"

FLEET: Final = """\
version: 1
fleet: {{name: Hall}}
server:
  port: {port}
  unknown_sources: create
pubsub:
  security: none
  url: {url}
  receive_timeout_s: 1.5
  keep_alive_s: 0.5
history: {{}}
bridges:
  floor: {{kind: ros2, space: 2}}
robots:
  rover:
    bridge: floor
    capacities: [mobile]
    data:
      speed: {{type: Double, unit: m/s}}
      goal: {{type: Double, origin: server, range: [-1, 1], initial: 0}}
      name: {{type: String, origin: server}}
      steps: {{type: Int32, array: true, origin: server}}
      pose:
        fields:
          x: {{type: Double}}
          frame: {{type: String}}
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    stdout: str
    stderr: str

    @property
    def objects(self) -> list[Any]:
        """The lines of stdout as JSON."""
        return [json.loads(line) for line in self.stdout.splitlines()]


@dataclass(frozen=True)
class Site:
    """A fleet's folder, with a running server."""

    folder: Path
    endpoint: str
    url: str
    processes: Processes

    def environment(self, user: str | None = "oscar", password: str = PASSWORD) -> dict[str, str]:
        given = {"UA_FLEET_USER": user, "UA_FLEET_PASSWORD": password} if user else {}
        return clean_environment(
            UA_FLEET_CONFIG=str(self.folder / "fleet.yaml"),
            UA_FLEET_ENDPOINT=self.endpoint,
            XDG_STATE_HOME=str(self.folder / "state-of-client"),
            **given,
        )

    def run(self, *arguments: str, user: str | None = "oscar", password: str = PASSWORD, stdin: str = "") -> Ended:
        """Run a command to its end."""
        ended = run(*command(*arguments), env=self.environment(user, password), stdin=stdin)
        assert "Traceback" not in ended.stderr
        return Ended(ended.returncode, ended.stdout, ended.stderr)

    def start(self, *arguments: str, user: str | None = "oscar") -> Child:
        """Start a command; it is ended with the site."""
        return self.processes.start(*command(*arguments), env=self.environment(user))


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "ua_fleet.cli", *arguments]


@pytest.fixture(scope="package")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A running server with two users; the clients of the tests are trusted."""
    folder, port, url = tmp_path_factory.mktemp("site"), free_tcp_port(), free_multicast_url()
    (folder / "fleet.yaml").write_text(FLEET.format(port=port, url=url))
    with Processes() as processes:
        made = Site(folder, f"opc.tcp://127.0.0.1:{port}/ua_fleet", url, processes)
        assert made.run("config", "assign-ids").code == 0
        for user, role in (("oscar", "operator"), ("olga", "observer")):
            ended = made.run("user", "add", user, "--role", role, "--password-file", "-", stdin=PASSWORD)
            assert ended.code == 0, ended.stderr
        server = made.start("serve", user=None)
        server.wait_for("ready: ")
        refused = made.run("read", "i=2258")
        assert (refused.code, refused.stdout) == (1, "")
        assert "does not trust this client's certificate" in refused.stderr
        assert "on the server run: ua-fleet cert trust --last --show" in refused.stderr
        rejected = [info for info in made.run("cert", "list", "--json").objects if info["state"] == "rejected"]
        assert len(rejected) == 1
        assert made.run("cert", "trust", rejected[0]["thumbprint"][:10]).code == 0
        yield made
        code = server.end()
        assert code == 130, "\n".join(server.lines)
        assert not any("Traceback" in line for line in server.lines)
