"""Certificates that end while all runs, and that have ended when somebody connects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from asyncua import ua
from asyncua.server.server import Server

from tests.integration.security.conftest import COUNTER_ONE, Site, heard, holes
from tests.integration.security.test_service import say, trust
from tests.integration.server_model.harness import serving
from tests.integration.server_security.harness import make_certificate
from tests.system import free_tcp_port
from tests.waiting import until
from ua_fleet.client import FleetClient
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.endpoint.certificates import CertificateFiles, create_certificate, trust_bridge
from ua_fleet.errors import AccessRefused

DAY_S = 86_400


def identity_of(site: Site, name: str) -> ClientIdentity:
    return ClientIdentity.of_bridge(site.folder / site.config.state_dir_of(name), "Fleet", name)


def short_lived(site: Site, name: str, seconds: float) -> ClientIdentity:
    """A bridge's certificate that ends in so many seconds, and that the server knows."""
    identity = identity_of(site, name)
    files = CertificateFiles(identity.certificate, identity.key)
    create_certificate(files, application_uri=identity.application_uri, common_name=name, days=seconds / DAY_S)
    trust_bridge(site.folder / site.config.server.state_dir, name, identity.certificate)
    return identity


async def renew(site: Site, name: str) -> None:
    """What `ua-fleet cert create --bridge NAME --renew --trust` does, for a kind of bridge that only tests know."""
    await identity_of(site, name).renew()
    await trust(site, name)


async def test_a_bridge_whose_certificate_ends_goes_on_with_its_keys_and_heals_when_it_is_renewed(
    secured: Site,
) -> None:
    # Keys for two minutes: more than all of this takes on a busy machine.
    secured.write_fleet(keys={"source": "service", "lifetime_s": 5.0, "future_keys": 24})
    await trust(secured, "one", "two")
    async with serving(secured.folder, secured.config):
        one, two = secured.bridge("one", wait=False), secured.bridge("two", wait=False)
        await until(lambda: heard(two, COUNTER_ONE))
        # The server ends the session of the certificate that was replaced, and the bridge logs in with this one.
        short_lived(secured, "one", 8.0)
        await until(lambda: say(one, "our certificate expires on"))
        await until(lambda: say(one, "our certificate expired on"))
        before = len(heard(two, COUNTER_ONE))
        await until(lambda: len(heard(two, COUNTER_ONE)) > before + 100)
    await until(
        lambda: say(two, "the key source is not reachable")
    )  # else a server that is quickly back was never missed
    async with serving(secured.folder, secured.config):
        # Only after its return the server knows nobody's channel any more.
        await until(lambda: say(two, "the key source is reachable again"))
        before = len(heard(two, COUNTER_ONE))
        await until(lambda: len(heard(two, COUNTER_ONE)) > before + 100)
        assert not say(one, "the key source is reachable again")
        await renew(secured, "one")
        await until(lambda: say(one, "the key source is reachable again"))
    assert holes(heard(two, COUNTER_ONE)) == []
    assert one.end() == 0
    assert not say(one, "Traceback")


async def test_a_bridge_whose_certificate_has_ended_says_what_to_run_and_starts_once_that_was_done(
    secured: Site,
) -> None:
    secured.write_fleet(keys={"source": "service"})
    identity = short_lived(secured, "one", -60.0)
    async with serving(secured.folder, secured.config):
        one = secured.bridge("one", wait=False)
        await until(lambda: say(one, "the key source is not reachable"))
        (line,) = say(one, "the key source is not reachable")
        assert "expired on" in line
        assert "run: ua-fleet cert create --bridge one --renew" in line
        assert f"ua-fleet cert trust --bridge one {identity.certificate}" in line
        assert not say(one, "ready")
        await renew(secured, "one")
        await until(lambda: say(one, "ready"))


async def test_a_bridge_whose_certificate_is_not_valid_yet_asks_for_the_clock(secured: Site) -> None:
    secured.write_fleet(keys={"source": "service"})
    identity = identity_of(secured, "one")
    made = make_certificate(secured.folder, "early", uri=identity.application_uri, days=(1, 30))
    identity.folder.mkdir(parents=True)
    for source, target in ((made.certificate, identity.certificate), (made.private_key, identity.key)):
        target.write_bytes(source.read_bytes())
        target.chmod(0o600)
    one = secured.bridge("one", wait=False)  # needs no server for that
    await until(lambda: say(one, "check the clock of this machine"))


async def test_clients_do_not_talk_to_a_server_whose_certificate_has_ended(tmp_path: Path) -> None:
    files = CertificateFiles(tmp_path / "server.der", tmp_path / "server-key.pem")
    create_certificate(files, application_uri="urn:x", common_name="x", days=-60 / DAY_S, server=True)
    server: Any = Server()
    await server.init()
    url = f"opc.tcp://127.0.0.1:{free_tcp_port()}/x"
    server.set_endpoint(url)
    await server.load_certificate(str(files.certificate))
    await server.load_private_key(str(files.private_key))
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    async with server:
        with pytest.raises(AccessRefused, match=r"expired on .*; on the server run: ua-fleet cert create --renew, and"):
            async with FleetClient.connect(url, identity=ClientIdentity(tmp_path / "client")):
                pass
