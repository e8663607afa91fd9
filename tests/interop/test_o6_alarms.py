"""A client of o6 (open62541) looks after an alarm."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key

from tests.integration.server_model.harness import OPERATOR, SPEED, fleet_config, reader, serving, until
from tests.integration.server_model.test_alarms import ALARM, robots
from tests.system import clean_environment, o6_python
from ua_fleet.endpoint.certificates import certificates_folder
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

CLIENT = Path(__file__).parent / "o6_alarms.py"


async def run_o6(script: Path, url: str, folder: Path, user: tuple[str, str], *arguments: str) -> str:
    """The last line that a client of o6 prints; it has the certificate of the harness's clients."""
    key = load_pem_private_key((folder / "client.pem").read_bytes(), None)
    der = folder / "client-key.der"
    der.write_bytes(key.private_bytes(Encoding.DER, PrivateFormat.TraditionalOpenSSL, NoEncryption()))
    server = certificates_folder(folder / "state") / "own" / "server.der"
    files = (str(folder / "client.der"), str(der), str(server))
    process = await asyncio.create_subprocess_exec(
        *(o6_python(), str(script), url, *user, *files, *arguments),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=clean_environment(),
    )
    output, errors = await asyncio.wait_for(process.communicate(), 60)
    assert process.returncode == 0, errors.decode()
    return output.splitlines()[-1].decode()


@pytest.mark.needs("o6")
async def test_a_client_of_o6_acknowledges_and_shelves(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots=robots())) as running:
        async with running.client() as client:
            running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
            running.peer.publish(SPEED, 1.2)
            await until(reader(client, f"{ALARM}.Retain"), lambda found: found.Value.Value is True)
        report = json.loads(await run_o6(CLIENT, running.url, tmp_path, OPERATOR, ALARM))
    assert report["active"] is True
    assert (report["acknowledged"], report["shelved"], report["unshelved"]) == ("GOOD", "GOOD", "GOOD")
    assert "BADCONDITIONBRANCHALREADYACKED" in report["again"].upper().replace("_", "")
    assert "TimedShelved" in report["state"]
