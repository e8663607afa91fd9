"""Clients of others from the host: one that plays UaExpert, node-opcua, and a Modbus client."""

from __future__ import annotations

import base64
import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, Final

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from tests.system import clean_environment
from tests.testbed.bed import Bed
from tests.testbed.engine import ROOT, Compose

__all__ = ["foreign_client", "modbus_client", "trust"]

_CLIENT: Final = ROOT / "tests" / "interop" / "testbed.cjs"
_PATIENCE_S: Final = 60.0


def trust(compose: Compose, certificate: bytes, service: str = "server") -> None:
    """Have the server (its service) trust a client by its certificate, which is brought into the container."""
    server = compose.container(service)
    program = "import sys, base64, pathlib; pathlib.Path(sys.argv[1]).write_bytes(base64.b64decode(sys.argv[2]))"
    server.python(program, "/tmp/client.der", base64.b64encode(certificate).decode())
    compose("exec", "-T", service, "ua-fleet", "cert", "trust", "/tmp/client.der")


def foreign_client(bed: Bed, compose: Compose) -> list[str]:
    """What goes wrong where a client does as README says: refused at first, trusted, and let in."""
    login = json.loads(compose("exec", "-T", "tasks", "ua-fleet", "testbed", "login", "talkrobots", "--json"))
    if str(bed.port) not in login["endpoint"]:
        return [f"login tells {login['endpoint']}, and the port is {bed.port}"]
    with tempfile.TemporaryDirectory() as folder:
        code, _, errors = _run(login, Path(folder))
        if code == 0:
            return ["the server let in a client whose certificate nobody has trusted"]
        listed = compose("exec", "-T", "server", "ua-fleet", "cert", "list", "--json")
        rejected = [info for info in map(json.loads, listed.splitlines()) if info["state"] == "rejected"]
        if len(rejected) != 1:
            return [f"{len(rejected)} certificates are listed as rejected, and not 1: {errors.strip()[-200:]}"]
        compose("exec", "-T", "server", "ua-fleet", "cert", "trust", rejected[0]["thumbprint"])
        code, output, errors = _run(login, Path(folder))
        if code != 0:
            return [f"the trusted client was not let in: {errors.strip()[-300:]}"]
        return _seen_problems(json.loads(output.splitlines()[-1]))


def _seen_problems(seen: dict[str, Any]) -> list[str]:
    found: list[str] = []
    robots = {"ridgeback", "ur3", "pioneer_1", "pioneer_2", "drone", "conveyor", "temperature_sensor"}
    if missing := robots - {name.partition(":")[2] for name in seen["robots"]}:
        found.append(f"UaExpert would not see {', '.join(sorted(missing))}")
    if seen["temperature"]["status"] != "Good" or not 20 < seen["temperature"]["value"] < 25:
        found.append(f"the temperature is {seen['temperature']}")
    if seen["started"] != "Good" or not seen["moved"]:
        found.append(f"the conveyor did not move: {seen['started']}")
    return found


def _run(login: dict[str, Any], folder: Path) -> tuple[int, str, str]:
    done = subprocess.run(
        ("node", str(_CLIENT), login["endpoint"], login["user"], login["password"], str(folder / "pki")),
        env=clean_environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=_PATIENCE_S,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def modbus_client(port: int) -> list[str]:
    """What goes wrong where a Modbus client on this machine reads the heartbeat twice."""
    try:
        return _heartbeat_problems(port)
    except (ModbusException, OSError) as error:
        return [f"the Modbus server does not answer: {error}"]


def _heartbeat_problems(port: int) -> list[str]:
    with ModbusTcpClient("127.0.0.1", port=port, timeout=2, retries=0) as client:
        if not client.connect():
            return [f"no Modbus server answers at port {port}"]
        first = client.read_input_registers(0, count=1, device_id=1)
        time.sleep(1.6)
        second = client.read_input_registers(0, count=1, device_id=1)
        if first.isError() or second.isError():
            return [f"the Modbus server answers {first}, {second}"]
        if first.registers == second.registers:
            return [f"the Modbus server's heartbeat stands still at {first.registers}"]
    return []
