"""The table of one value in all forms (docs/unified-namespace.md): each line prints what the page says."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.integration.mqtt.broker import Broker
from tests.integration.server_model.harness import serving
from tests.system import Processes, cli
from tests.unit.docs.pages import ROOT
from tests.waiting import until
from ua_fleet.config.load import load_content

pytestmark = pytest.mark.needs("mosquitto")

PAGE = ROOT / "docs" / "unified-namespace.md"
ROW = re.compile(r"^\| (?P<setting>.+?) \| `(?P<line>[^`]+)` \| `(?P<shown>.+?)` \|$", re.MULTILINE)


class Row(NamedTuple):
    setting: str
    line: str
    shown: str


def rows() -> list[Row]:
    _, _, table = PAGE.read_text(encoding="utf-8").partition("<!-- table: forms -->\n")
    table, _, _ = table.partition("\n\n")
    return [Row(*match.groups()) for match in ROW.finditer(table)]


def fleet(udp_url: str, broker: str, port: int, payload: str) -> dict[str, Any]:
    """One value over all connections at once, each with topics of its own."""

    def over(name: str, **more: Any) -> dict[str, Any]:
        used = {"prefix": f"opcua-{name}", "queue": f"{name}/{{topic}}"}
        return {"name": name, "url": broker, "broker": used, **more}

    as_json = {"security": "broker", "encoding": "json"}
    return {
        "version": 1,
        "fleet": {"name": "Hall"},
        "server": {"port": port, "trust_all_clients": True},
        "pubsub": [
            {"name": "udp", "security": "none", "url": udp_url, "repeat_interval_s": 0.5},
            over("uadp", security="none"),
            *[over(form, json_form=form, **as_json) for form in ("compact", "verbose", "raw")],
        ],
        "bridges": {"floor": {"kind": "ros2", "space": 2, "status_id": 1900}},
        "robots": {
            "carrier": {
                "bridge": "floor",
                "data": {"speed_limit": {"id": 1001, "type": "Double", "origin": "server", "initial": 1.5}},
            }
        },
        "unified_namespace": {"url": broker, "site": "acme/lyon", "payload": payload},
    }


def matches(shown: str, line: str) -> bool:
    return re.fullmatch(".*".join(re.escape(part) for part in shown.split("…")), line) is not None


@pytest.mark.parametrize("payload", ["object", "value"])
async def test_each_line_prints_what_the_page_says(
    tmp_path: Path, broker: Broker, udp_url: str, tcp_port: int, processes: Processes, payload: str
) -> None:
    path = tmp_path / "fleet.json"
    path.write_text(json.dumps(fleet(udp_url, broker.url, tcp_port, payload)))
    config = load_content(path.read_bytes(), "fleet.json", {})
    wanted = [row for row in rows() if "payload" not in row.setting or f"payload: {payload}" in row.setting]
    assert len(wanted) == 6
    for row in wanted:
        words = shlex.split(row.line)
        if words[0] == "mosquitto_sub":
            at = words.index("broker")
            words[at : at + 1] = ["127.0.0.1", "-p", str(broker.port)]
            processes.start(*words, whole=True)
        else:
            processes.start(*cli(*words[1:], "--config", str(path), "--connection", "udp"))
    async with serving(tmp_path, config):
        for row, child in zip(wanted, processes.children, strict=True):
            lines = child.lines
            await until(
                lambda row=row, lines=lines: any(matches(row.shown, line) for line in list(lines)),  # type: ignore[misc]
                f"{row.line} printing {row.shown}",
            )
