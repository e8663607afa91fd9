from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import structlog

from tests.integration.server_security.harness import make_certificate
from ua_fleet.endpoint.certificates import ensure_application_certificate, trust, trust_bridge
from ua_fleet.endpoint.expiry import PERIOD_S, CertificateWatch


def test_a_running_server_says_of_each_certificate_that_it_ends(tmp_path: Path) -> None:
    ensure_application_certificate(tmp_path, "urn:x")
    cell = make_certificate(tmp_path, "cell", uri="urn:cell", days=(-1, 10))
    trust_bridge(tmp_path, "cell", cell.certificate)
    trust(tmp_path, make_certificate(tmp_path, "plc", uri="urn:plc", days=(-30, -1)).certificate)
    clock, wall = [0.0], [datetime.now(UTC)]
    watch = CertificateWatch(tmp_path, lambda: clock[0], lambda: wall[0])
    assert watch.due_in_s() == 0
    with structlog.testing.capture_logs() as said:
        watch.poll()
        assert watch.due_in_s() == PERIOD_S
        watch.poll()
        assert sorted(line["event"].rpartition(" on ")[0] for line in said) == [
            "a certificate expired",
            "the certificate of bridge cell expires",
        ]
        assert {line["todo"] for line in said} == {
            "ua-fleet cert create --bridge cell --renew --trust",
            "its owner has to renew it; then: ua-fleet cert trust FILE",
        }
        said.clear()
        clock[0] += PERIOD_S
        wall[0] += timedelta(hours=1)
        watch.poll()
        assert said == []
        clock[0] += PERIOD_S
        wall[0] += timedelta(days=365 * 5 - 3)
        watch.poll()
        (own,) = [line for line in said if "server.der" in line["certificate"]]
    assert own["todo"] == "ua-fleet cert create --renew, then restart the server"
