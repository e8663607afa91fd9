"""What `fleet.yaml` says of monitoring, at the start of a process."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from tests.integration.cli.conftest import command
from tests.system import Processes, clean_environment, free_multicast_url, free_tcp_port
from ua_fleet.monitoring.address import ADDRESS_FILE


@pytest.mark.parametrize(
    ("section", "key"),
    [
        ("monitoring: {{port: {port}}}\nserver: {{port: 0}}", "monitoring.port"),
        ("server: {{port: 0, monitoring_port: {port}}}", "server.monitoring_port"),
    ],
)
def test_a_port_in_use_ends_the_process_with_one_line(
    section: str, key: str, processes: Processes, tmp_path: Path
) -> None:
    path = tmp_path / "fleet.yaml"
    with socket.create_server(("127.0.0.1", 0)) as held:
        port = held.getsockname()[1]
        url = free_multicast_url()
        path.write_text(f"version: 1\npubsub: {{security: none, url: '{url}'}}\n{section.format(port=port)}\n")
        child = processes.start(*command("serve", "-c", str(path)), env=clean_environment(UA_FLEET_LOG="error"))
        assert child.process.wait(60) == 1
        child.end()
    assert child.lines[-1] == (
        f"ua-fleet: health and metrics cannot be served at 127.0.0.1:{port} (address already in use); "
        f"set {key} to a free port or 0, and monitoring.host to an address of this machine"
    )
    assert not any(line.startswith("ready") or "Traceback" in line for line in child.lines)


def test_it_can_be_turned_off(processes: Processes, tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(
        f"version: 1\npubsub: {{security: none, url: '{free_multicast_url()}'}}\nmonitoring: {{enabled: false}}\n"
        f"server: {{port: {free_tcp_port()}}}\n"
    )
    child = processes.start(*command("serve", "-c", str(path)))
    child.wait_for("ready: ", 30)
    assert not (tmp_path / "state" / ADDRESS_FILE).exists()
    assert not any("health and metrics" in line for line in child.lines)
    assert child.end() == 130
