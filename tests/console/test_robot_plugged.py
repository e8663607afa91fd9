"""The page of a robot that a sensor is plugged into and pulled out of."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests import system
from tests.console.conftest import FLEET, USERS, Console, console_of
from tests.plugged_device import PtyDevice
from tests.system import Processes, clean_environment
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

YAML = r"""
version: 1
server: {port: PORT, trust_all_clients: true}
pubsub: {security: none, url: "URL", keep_alive_s: 0.2, receive_timeout_s: 0.8}
bridges:
  pc: {kind: plugged, space: 300, status_id: 1, devices: {thermometer: {path: PATH}}}
robots:
  box:
    bridge: pc
    card: [temperature]
    skill_status_id: 1902
    data:
      temperature:
        id: 10
        type: Double
        unit: "°C"
        gives: [temperature]
        source: {device: thermometer, line: "T={value}", ask: "T?\n", period_s: 0.2}
"""


class Thermometer:
    """What is plugged into the box: it is warmer each time that it is asked."""

    def __init__(self, device: PtyDevice) -> None:
        self.degrees, self.device = 20.0, device

    @classmethod
    def at(cls, path: Path) -> Thermometer:
        made: list[Thermometer] = []

        def answer(device: PtyDevice, line: str) -> None:
            if line == "T?":
                made[0].degrees = 20.0 + (made[0].degrees + 0.5) % 10
                device.say(f"T={made[0].degrees}\n")

        made.append(cls(PtyDevice(path, answer)))
        return made[0]


@pytest.fixture(scope="module")
def thermometer(tmp_path_factory: pytest.TempPathFactory) -> Thermometer:
    return Thermometer.at(tmp_path_factory.mktemp("devices") / "thermometer")


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory, thermometer: Thermometer) -> Iterator[Console]:
    """The console of a fleet that is a box alone."""
    folder, port = tmp_path_factory.mktemp("fleet"), system.free_tcp_port()
    text = YAML.replace("PORT", str(port)).replace("URL", system.free_multicast_url())
    (folder / "fleet.yaml").write_text(text.replace("PATH", str(thermometer.device.path)))
    users = UserStore(folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(mode=0o700)
    users.add(*USERS["operator"], Role.OPERATOR)
    environment = clean_environment(PYTHONUNBUFFERED="1", UA_FLEET_CONFIG=str(folder / "fleet.yaml"))
    with Processes() as processes:
        for arguments in (("serve",), ("bridge", "pc")):
            child = processes.start(sys.executable, "-m", "ua_fleet.cli", *arguments, env=environment)
            child.wait_for("ready")
        endpoint = f"opc.tcp://127.0.0.1:{port}/ua_fleet"
        with console_of(tmp_path_factory.mktemp("console"), {FLEET: endpoint}) as running:
            yield running


def test_a_sensor_that_is_plugged_in_appears(
    open_page: Callable[..., Page], thermometer: Thermometer, picture: Callable[[Page, str], None]
) -> None:
    page = open_page("operator", "#/hall/robot/box")
    expect(page.get_by_role("heading", level=1, name="box")).to_be_visible()
    main = page.get_by_role("main")
    row = page.get_by_role("table", name="Data").get_by_role("row", name="temperature")
    expect(row).to_contain_text("—")
    expect(row).not_to_contain_text("°C")
    with thermometer.device:
        expect(row).to_contain_text("°C", timeout=20_000)
        expect(row).to_contain_text("Good")
        expect(main).to_contain_text("Idle")
        line = page.get_by_role("img", name="Course of temperature").locator("path")
        expect(line).to_have_attribute("d", re.compile("L.*L.*L"))
        page.get_by_role("button", name="Draw temperature in the chart").click()
        chart = page.get_by_role("region", name="Chart")
        expect(chart.get_by_role("img", name=re.compile("^temperature is 2[0-9]"))).to_be_visible()
        picture(page, "robot-plugged")
        # What fleet.yaml marks stands on the card.
        main.get_by_role("link", name="Fleet").click()
        card = page.get_by_role("article", name="box")
        expect(card).to_contain_text("temperature")
        expect(card).to_contain_text(re.compile(r"2[0-9.]+ °C"))
        picture(page, "fleet-card")
        page.go_back()
        expect(chart.get_by_role("img", name=re.compile("^temperature is 2[0-9]"))).to_be_visible()
    expect(row).to_contain_text("Bad", timeout=20_000)
    # What is not Good is a gap, and what was seen before stays.
    expect(chart.get_by_role("img", name=re.compile("^temperature is —; least 2[0-9]"))).to_be_visible()
