"""The alerts and the dashboard of `docs/monitoring`, and the figures of a server, as Prometheus reads them."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Final
from urllib.request import urlopen

import pytest

from tests import system
from tests.integration.monitoring.conftest import Plant, until

pytestmark = pytest.mark.needs("promtool")

FILES: Final = system.ROOT / "docs" / "monitoring"
ALERTS_TEST: Final = Path(__file__).with_name("alerts_test.yml")


def promtool(folder: Path, *arguments: str, given: bytes = b"") -> str:
    """What promtool says; the test fails where it finds anything wrong."""
    done = subprocess.run([system.promtool(), *arguments], cwd=folder, input=given, capture_output=True, check=False)
    said = (done.stdout + done.stderr).decode()
    assert done.returncode == 0, said
    return said


def test_each_alert_is_silent_while_all_is_well_and_raised_by_what_it_is_for(tmp_path: Path) -> None:
    shutil.copy(FILES / "alerts.yml", tmp_path)
    shutil.copy(ALERTS_TEST, tmp_path)
    assert "SUCCESS" in promtool(tmp_path, "check", "rules", "alerts.yml")
    assert "SUCCESS" in promtool(tmp_path, "test", "rules", ALERTS_TEST.name)
    tested = ALERTS_TEST.read_text(encoding="utf-8")
    names = [line.split()[-1] for line in (FILES / "alerts.yml").read_text().splitlines() if "- alert:" in line]
    assert [name for name in names if f'"{name}"' not in tested] == []


def test_the_queries_of_the_dashboard_can_be_asked(tmp_path: Path) -> None:
    panels = json.loads((FILES / "dashboard.json").read_text(encoding="utf-8"))["panels"]
    asked = [target["expr"] for panel in panels for target in panel.get("targets", [])]
    assert len(asked) > 20
    rules = [{"record": f"panel:{number}", "expr": expr} for number, expr in enumerate(asked)]
    for rule in rules:
        rule["expr"] = (
            rule["expr"].replace("$__rate_interval", "5m").replace("$instance", ".*").replace("$job", "ua_fleet")
        )
        assert "$" not in rule["expr"]
    (tmp_path / "rules.yml").write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
    assert f"{len(rules)} rules found" in promtool(tmp_path, "check", "rules", "rules.yml")


async def test_promtool_finds_nothing_wrong_with_the_figures(plant: Plant, tmp_path: Path) -> None:
    for process in ("server", "bridge", "modbus"):

        async def ready(process: str = process) -> bool:
            return (await plant.health(process)).is_well

        await until(ready, f"{process} ready")
        with urlopen(f"{plant.monitoring_url(process)}/metrics", timeout=10) as answer:
            assert promtool(tmp_path, "check", "metrics", given=answer.read()) == ""
