from __future__ import annotations

import json
from pathlib import Path

from tests.unit.cli.conftest import Invoke
from ua_fleet.endpoint.audit import AuditLog, Caller


def test_the_command(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text("version: 1\npubsub: {security: none}\n")
    assert invoke("audit", "verify").code == 2
    path = tmp_path / "state" / "audit.log"
    log = AuditLog(path)
    for number in range(40):
        log.record("write", Caller("10.0.0.7:5000", "anna", "operator"), "Good", node=f"n{number}")
    log.close()
    ended = invoke("audit", "verify")
    assert ended.code == 0
    anchor = ended.stdout.rpartition(" ")[2].strip()
    assert invoke("audit", "verify", "--anchor", anchor).code == 0
    assert json.loads(invoke("audit", "verify", "--json").stdout)["whole"] is True
    path.write_text(path.read_text().replace('"n1"', '"n7"'))
    ended = invoke("audit", "verify")
    assert ended.code == 1
    assert ended.stdout.startswith(f"{path}:3: the line before this one (number ")
    assert invoke("audit", "verify", "--anchor", "12").code == 2
