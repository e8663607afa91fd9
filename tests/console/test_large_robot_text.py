"""A text of 1 MB that a robot itself says, over a real bridge: it is seen shortened, and a larger one is counted."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pytest
from playwright.sync_api import Locator, Page, expect
from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path

from tests import system
from tests.console.conftest import FLEET, USERS, Console, console_of
from tests.system import ROOT, Processes
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

pytestmark = pytest.mark.needs("ros2")

Open = Callable[..., Page]
NODE: Final = Path(__file__).parent / "nodes" / "speaker.py"
LARGE: Final = 1_000_000
TOO_LARGE: Final = 5_000_000
"""More than a PubSub message has at most, which is `pubsub.max_message_bytes`: 4 MiB."""


@dataclass
class Speaker:
    """The robot: how much it says is what the file says."""

    file: Path
    endpoint: str

    def says(self, characters: int) -> None:
        """Say so much from now on."""
        new = self.file.with_suffix(".new")
        new.write_text(str(characters))
        new.replace(self.file)


@pytest.fixture(scope="module")
def speaker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Speaker]:
    """A robot with two texts, its bridge and a server."""
    folder, port = tmp_path_factory.mktemp("speaker"), system.free_tcp_port()
    with Processes() as processes, system.ros_domain() as domain:
        data = {
            name: {"id": 1002 + number, "type": "String", "source": {"topic": f"/{name}", "type": "std_msgs/String"}}
            for number, name in enumerate(("log", "mood"))
        }
        raw: dict[str, Any] = {
            "version": 1,
            "server": {"port": port, "trust_all_clients": True},
            "pubsub": {"security": "none", "url": system.free_multicast_url(), "interface": "lo"},
            "bridges": {"floor": {"kind": "ros2", "space": domain, "status_id": 1001}},
            "robots": {"speaker": {"bridge": "floor", "data": data}},
        }
        path = folder / "fleet.json"
        path.write_text(json.dumps(raw))
        users = UserStore(folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
        users.path.parent.mkdir(parents=True)
        users.add(*USERS["observer"], Role.OBSERVER)
        bridge = processes.fork(ROOT / "tests" / "integration" / "run_bridge.py", path, "floor")
        processes.fork(ROOT / "tests" / "integration" / "run_server.py", path).wait_for("opc.tcp://")
        environment = system.clean_environment(
            ROS_DOMAIN_ID=str(domain),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            **{PROFILES_VARIABLE: str(profile_path("robot"))},
        )
        found = Speaker(folder / "log", f"opc.tcp://127.0.0.1:{port}/ua_fleet")
        found.says(LARGE)
        (folder / "mood").write_text("20")
        for topic in data:
            processes.start(sys.executable, NODE, f"/{topic}", folder / topic, env=environment).wait_for("ready")
        bridge.wait_for("ready")
        yield found


@pytest.fixture(scope="module")
def console(speaker: Speaker, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """Its console."""
    with console_of(tmp_path_factory.mktemp("console"), {FLEET: speaker.endpoint}) as running:
        yield running


def _row(page: Page, name: str) -> Locator:
    return page.get_by_role("table", name="Data").get_by_role("row").filter(has_text=name)


def test_a_robots_large_text_is_cut_and_a_larger_one_is_counted(speaker: Speaker, open_page: Open) -> None:
    page = open_page("observer", "#/hall/robot/speaker")
    log, mood = _row(page, "log"), _row(page, "mood")
    expect(log).to_contain_text(f"{LARGE} characters, beginning <b>{LARGE}</b>xxx")
    expect(log).to_contain_text("Good")
    assert log.locator("b").count() == 0
    assert len(log.inner_text()) < 20_000
    speaker.says(LARGE + 1)
    expect(log).to_contain_text(f"{LARGE + 1} characters")

    speaker.says(TOO_LARGE)
    drops = open_page("observer", "#/hall/pubsub?show=drops")
    dropped = drops.get_by_role("row").filter(has_text="conversion")
    expect(dropped).to_contain_text("floor")
    # What is shown is the last one that came; it is not of now, and the robot's other values go on.
    expect(log).not_to_contain_text("Good")
    expect(log).to_contain_text(f"{LARGE + 1} characters")
    expect(mood).to_contain_text("<b>20</b>")
    expect(mood).to_contain_text("now")
    speaker.says(LARGE)
    expect(log).to_contain_text(f"{LARGE} characters")
    expect(log).to_contain_text("Good")
