"""A camera of rclpy whose `sensor_msgs/Image` is seen on the page of its robot."""

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
from tests.system import ROOT, Child, Processes
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

pytestmark = pytest.mark.needs("ros2")

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
PLACE: Final = "#/hall/robot/eye"
NODE: Final = Path(__file__).parent / "nodes" / "camera.py"
FIELDS: Final = {
    "height": {"type": "UInt32"},
    "width": {"type": "UInt32"},
    "encoding": {"type": "String"},
    "is_bigendian": {"type": "Byte"},
    "step": {"type": "UInt32"},
    "data": {"type": "ByteString"},
}
POINTS: Final = """canvas => {
  const copy = document.createElement('canvas');
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const drawn = copy.getContext('2d', {willReadFrequently: true});
  drawn.drawImage(canvas, 0, 0);
  return [0.25, 0.75].map(at => [...drawn.getImageData(canvas.width * at, canvas.height / 2, 1, 1).data]);
}"""
"""The points in the middle of both halves."""


@dataclass
class Camera:
    """The robot's camera: what it sees is what the file says."""

    file: Path
    endpoint: str
    bridge: Child

    def sees(self, encoding: str, width: int, height: int, *points: str) -> None:
        """Show a picture of these points from now on."""
        new = self.file.with_suffix(".new")
        new.write_text(f"{encoding} {width} {height} {' '.join(points)}")
        new.replace(self.file)


@pytest.fixture(scope="module")
def camera(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Camera]:
    """A robot that is a camera, with its bridge and a server."""
    folder, port = tmp_path_factory.mktemp("eye"), system.free_tcp_port()
    with Processes() as processes, system.ros_domain() as domain:
        source = {"topic": "/camera/image_raw", "type": "sensor_msgs/Image"}
        raw: dict[str, Any] = {
            "version": 1,
            "server": {"port": port, "trust_all_clients": True},
            "pubsub": {"security": "none", "url": system.free_multicast_url(), "interface": "lo"},
            "bridges": {"floor": {"kind": "ros2", "space": domain, "status_id": 1001}},
            "robots": {
                "eye": {"bridge": "floor", "data": {"camera": {"id": 1002, "fields": FIELDS, "source": source}}}
            },
        }
        path = folder / "fleet.json"
        path.write_text(json.dumps(raw))
        users = UserStore(folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
        users.path.parent.mkdir(parents=True)
        users.add(*USERS["observer"], Role.OBSERVER)
        bridge = processes.fork(ROOT / "tests" / "integration" / "run_bridge.py", path, "floor")
        processes.fork(ROOT / "tests" / "integration" / "run_server.py", path).wait_for("opc.tcp://")
        found = Camera(folder / "seen", f"opc.tcp://127.0.0.1:{port}/ua_fleet", bridge)
        found.sees("rgb8", 40, 30, "ff0000", "0000ff")
        environment = system.clean_environment(
            ROS_DOMAIN_ID=str(domain),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            **{PROFILES_VARIABLE: str(profile_path("robot"))},
        )
        processes.start(sys.executable, NODE, "/camera/image_raw", found.file, env=environment).wait_for("ready")
        bridge.wait_for("ready")
        yield found


@pytest.fixture(scope="module")
def console(camera: Camera, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """Its console."""
    with console_of(tmp_path_factory.mktemp("console"), {FLEET: camera.endpoint}) as running:
        yield running


def opened(open_page: Open) -> Page:
    page = open_page("observer", PLACE)
    page.get_by_role("button", name="Picture of camera").click(timeout=60_000)
    return page


def picture_of(page: Page) -> Locator:
    return page.get_by_role("img", name="Picture of camera")


def shows(page: Page, width: int, *halves: tuple[int, int, int]) -> None:
    """Wait until the picture is so wide, and has these colours in its halves."""
    expect(picture_of(page)).to_have_js_property("width", width, timeout=60_000)
    expected = [[*colour, 255] for colour in halves]
    page.wait_for_function(
        f"expected => {{ const canvas = document.querySelector('canvas[role=img]');"
        f"return canvas && JSON.stringify(({POINTS})(canvas)) === JSON.stringify(expected) }}",
        arg=expected,
    )


RED, GREEN, BLUE, BLACK, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (0, 0, 0), (255, 255, 255)


def test_the_common_encodings_are_seen_in_their_colours(camera: Camera, open_page: Open, picture: Picture) -> None:
    page = opened(open_page)
    shows(page, 40, RED, BLUE)
    grey = (128, 128, 128)
    for width, (encoding, *points), colours in (
        (42, ("bgr8", "ff0000", "00ff00"), (BLUE, GREEN)),
        (44, ("rgba8", "00ff0000", "ff0000ff"), (GREEN, RED)),
        (46, ("bgra8", "0000ff80", "ff000080"), (RED, BLUE)),
        (48, ("mono8", "80", "ff"), (grey, WHITE)),
        (50, ("mono16", "ff80", "ffff"), (grey, WHITE)),
    ):
        camera.sees(encoding, width, 30, *points)
        shows(page, width, *colours)
    figure = page.get_by_role("figure").filter(has=picture_of(page))
    expect(figure).not_to_contain_text("black")
    camera.sees("bayer_rggb8", 52, 30, "00", "80")
    shows(page, 52, BLACK, grey)
    expect(figure).to_contain_text("The pattern of the sensor (Bayer) is shown in grey.")
    # A depth of 500 to 4500 mm.
    camera.sees("16UC1", 54, 30, "f401", "9411")
    shows(page, 54, BLACK, WHITE)
    expect(figure).to_contain_text("500 is black, 4500 is white.")
    picture(page, "robot-camera")


def test_what_is_not_shown_is_said(camera: Camera, open_page: Open) -> None:
    page = opened(open_page)
    camera.sees("32FC1", 20, 30, "0000803f", "00000040")
    expect(
        page.get_by_text("Pictures of the encoding 32FC1 are not shown. Encodings that are shown: rgb8, ")
    ).to_be_visible(timeout=60_000)
    expect(picture_of(page)).to_have_count(0)
    camera.sees("rgb8", 30, 30, "ffffff", "000000")
    shows(page, 30, WHITE, BLACK)


def test_the_newest_of_many_large_pictures_is_seen_and_the_page_does_not_stand(camera: Camera, open_page: Open) -> None:
    page = opened(open_page)
    camera.sees("rgb8", 640, 480, "ff0000", "00ff00")
    shows(page, 640, RED, GREEN)
    page.evaluate(
        "window.reads = [];"
        "new PerformanceObserver(list => reads.push(...list.getEntries())).observe({type: 'resource'})"
    )
    assert [worker.url for worker in page.workers if "pixels" in worker.url], "points are read in a thread of their own"
    camera.sees("bgr8", 642, 480, "ff0000", "00ff00")
    shows(page, 642, BLUE, GREEN)
    page.wait_for_function("() => reads.filter(one => one.name.endsWith('node.picture')).length >= 5", timeout=60_000)


def test_a_camera_that_is_silent_shows_nothing_of_now(camera: Camera, open_page: Open) -> None:
    page = opened(open_page)
    camera.sees("rgb8", 40, 30, "ff0000", "0000ff")
    shows(page, 40, RED, BLUE)
    figure = page.get_by_role("figure").filter(has=picture_of(page))
    expect(figure).not_to_contain_text("Not current")
    camera.bridge.end()
    expect(figure).to_contain_text("Not current", timeout=60_000)
    shows(page, 40, RED, BLUE)
