"""Servers that a client has met: by endpoint and ApplicationUri, old files, impostors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.integration.server_security.harness import make_certificate
from ua_fleet.client import ClientIdentity
from ua_fleet.client.known_servers import KnownServer, KnownServers, Meeting
from ua_fleet.errors import AccessRefused

HERE = "opc.tcp://127.0.0.1:4840/ua_fleet"
THERE = "opc.tcp://10.0.0.5:4840/ua_fleet"
HALL, YARD = "urn:ua-fleet:hall:server", "urn:ua-fleet:yard:server"


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("servers")
    uris = {"hall": HALL, "other hall": HALL, "yard": YARD}
    return {name: make_certificate(folder, name, uri=uri).certificate.read_bytes() for name, uri in uris.items()}


@pytest.fixture
def known(tmp_path: Path) -> KnownServers:
    return KnownServers(tmp_path / "servers.json")


def test_a_server_is_trusted_on_first_use_and_held_to_it(known: KnownServers, certificates: dict[str, bytes]) -> None:
    assert known.meet(HERE, certificates["hall"]) == Meeting(is_first=True)
    assert known.meet(HERE, certificates["hall"]) == Meeting(is_first=False)
    with pytest.raises(
        AccessRefused, match=f"another certificate .* if that is right, run: ua-fleet cert forget {HERE}$"
    ):
        known.meet(HERE, certificates["other hall"])
    assert [server.application_uri for server in known.forget(HERE)] == [HALL]
    assert known.meet(HERE, certificates["other hall"]).is_first


@pytest.mark.parametrize("endpoint", [HERE, "opc.tcp://localhost:4840", "opc.tcp://[::1]:4840/x"])
def test_fleets_one_after_the_other_on_this_machine(
    known: KnownServers, certificates: dict[str, bytes], endpoint: str
) -> None:
    known.meet(endpoint, certificates["hall"])
    assert known.meet(endpoint, certificates["yard"]) == Meeting(is_first=True, others=(HALL,))
    assert not known.meet(endpoint, certificates["hall"]).is_first
    with pytest.raises(AccessRefused, match="another certificate"):
        known.meet(endpoint, certificates["other hall"])


@pytest.mark.parametrize("endpoint", [THERE, "opc.tcp://localhost.example:4840", "opc.tcp://127.0.0.1.example:4840"])
def test_an_impostor_elsewhere_may_say_any_uri(
    known: KnownServers, certificates: dict[str, bytes], endpoint: str
) -> None:
    known.meet(endpoint, certificates["hall"])
    with pytest.raises(AccessRefused, match=rf"another certificate \({YARD} .* than before \({HALL} "):
        known.meet(endpoint, certificates["yard"])


def test_what_is_no_certificate_is_no_other_fleet(known: KnownServers) -> None:
    assert known.meet(HERE, b"one").is_first
    assert not known.meet(HERE, b"one").is_first
    with pytest.raises(AccessRefused, match="another certificate"):
        known.meet(HERE, b"two")


def test_what_an_older_program_has_met(tmp_path: Path, certificates: dict[str, bytes]) -> None:
    path = tmp_path / "servers.json"
    known = KnownServers(path)
    known.meet(THERE, certificates["hall"])
    mark = known.load()[0].thumbprint
    path.write_text(json.dumps({THERE: mark}))
    assert known.load() == [KnownServer(THERE, "", mark)]
    assert not known.meet(THERE, certificates["hall"]).is_first
    with pytest.raises(AccessRefused, match="another certificate"):
        known.meet(THERE, certificates["other hall"])


def test_a_bridge_names_its_own_file(tmp_path: Path, certificates: dict[str, bytes]) -> None:
    identity = ClientIdentity.of_bridge(tmp_path, "hall", "cell")
    identity.check_server(THERE, certificates["hall"])
    with pytest.raises(AccessRefused, match=f"run: ua-fleet cert forget {THERE} --bridge cell$"):
        identity.check_server(THERE, certificates["yard"])


@pytest.mark.parametrize(
    "content",
    ["{", "[]", '"x"', '{"opc.tcp://a": 1}', '{"version": 2}', '{"version": 2, "servers": [{"endpoint": "x"}]}'],
)
def test_a_broken_list_of_servers_is_said(known: KnownServers, tmp_path: Path, content: str) -> None:
    (tmp_path / "servers.json").write_text(content)
    with pytest.raises(AccessRefused, match=r"servers\.json cannot be read .*; remove it, and servers are met anew"):
        known.meet(HERE, b"one")
    assert (tmp_path / "servers.json").read_text() == content
