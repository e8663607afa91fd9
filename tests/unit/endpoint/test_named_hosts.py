"""A server tells which names its certificate lacks, since its clients tell it nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from structlog.testing import capture_logs

from ua_fleet.config.schema import ServerConfig
from ua_fleet.endpoint import named_hosts
from ua_fleet.endpoint.certificates import ensure_application_certificate, load_certificate
from ua_fleet.endpoint.hardened_server import create_server
from ua_fleet.endpoint.named_hosts import missing_hosts
from ua_fleet.printing import config_option

URI = "urn:test:server"


@pytest.mark.parametrize(
    ("host", "missing"),
    [
        ("robots.local", []),
        ("Robots.Local", []),
        ("127.0.0.1", []),
        ("localhost", []),
        ("2001:DB8:0::7", []),
        ("10.0.0.7", ["10.0.0.7"]),
        ("hall2.local", ["hall2.local"]),
        ("0.0.0.0", ["10.0.0.8"]),
        ("::", ["10.0.0.8"]),
    ],
)
def test_what_a_certificate_lacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, host: str, missing: list[str]
) -> None:
    files = ensure_application_certificate(tmp_path, URI, ["robots.local", "2001:db8::7"])
    monkeypatch.setattr(named_hosts, "machine_addresses", lambda: ["2001:db8::7", "10.0.0.8"])
    assert missing_hosts(load_certificate(files.certificate), host) == missing


async def test_a_server_warns_at_its_start_until_its_certificate_is_made_anew(tmp_path: Path) -> None:
    config_option(Path("hall2.yaml"), Path("fleet.yaml"))
    config = ServerConfig(host="robots.local", port=0, trust_all_clients=True)
    ensure_application_certificate(tmp_path, URI, ["127.0.0.1"])

    async def warned() -> list[tuple[str, str]]:
        with capture_logs() as lines:
            server = await create_server(config, tmp_path, application_uri=URI)
            server.context.audit.close()
        return [(line["event"], line["names"]) for line in lines if "names" in line]

    said = "the server's certificate lacks names, and clients that compare them refuse it; run: ua-fleet cert create"
    assert await warned() == [(f"{said} --renew -c hall2.yaml, then restart the server", "robots.local")]
    ensure_application_certificate(tmp_path, URI, [config.host], renew=True)
    assert await warned() == []
