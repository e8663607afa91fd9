"""A robot of rclpy is driven by hand from the page: what it records says how fast it was, and that it stood.

Its own watch, the bridge, the server and the console are processes, as in a plant.
"""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import pytest
from playwright.sync_api import Page, expect

from tests import system
from tests.console.conftest import FLEET, Console, console_of
from tests.integration.scenarios.conftest import ENGINEER
from tests.integration.server_model.harness import OBSERVER, OPERATOR
from tests.integration.teleoperation.conftest import PERIOD_S, SPEED, STOP_S, Hall, Speed
from tests.system import ROOT, Child, Processes
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

pytestmark = pytest.mark.needs("ros2")

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
PLACE: Final = "#/hall/drive/carrier"
DEADMAN_S: Final = 5.0
"""As long as can be: where a busy machine has a page, the console or the bridge stand still for longer, the lease ends,
as it must. While a picture is taken or axe looks, all pages of the browser stand for a while. The robot's watch waits
for as long, since a busy machine has the bridge stand still, too."""
SLACK_S: Final = 0.5
WAIT_S: Final = 60.0
MILLISECONDS: Final = re.compile(r"^\d+ ms$")
HALF: Final = SPEED / 2
"""The page begins with half of the limits."""


@dataclass
class Plant:
    """A robot with its bridge, and a server before it."""

    hall: Hall
    endpoint: str
    start_server: Callable[[], Child]
    server: Child

    def until(self, is_so: Callable[[list[Speed]], bool], what: str = "heard") -> float:
        """Wait for what the robot records; when it was there."""
        until = time.monotonic() + WAIT_S
        while not is_so(speeds := self.hall.speeds(what)):
            assert time.monotonic() < until, speeds[-5:]
            time.sleep(0.01)
        return time.monotonic()

    def drives(self, linear: float, angular: float = 0.0) -> None:
        """Wait until it drives as fast as this."""
        expected = pytest.approx((linear, angular), abs=1e-6)
        self.until(lambda speeds: bool(speeds) and (speeds[-1].linear, speeds[-1].angular) == expected)

    def stands_after(self, moment: float) -> tuple[float, float]:
        """Wait until it stands, and goes on standing; when it began to stop and when it stood."""
        self.until(lambda speeds: speeds[-1].at > moment and not speeds[-1].linear and not speeds[-1].angular)
        time.sleep(0.3)
        speeds = self.hall.speeds("heard", moment - 1)
        sizes = [(one.at, abs(one.linear) + abs(one.angular)) for one in speeds]
        stood = max(at for (_, before), (at, after) in pairwise(sizes) if before and not after)
        assert not any(one.linear or one.angular for one in self.hall.speeds("moved", stood))
        falling = [at for (at, before), (_, after) in pairwise(sizes) if after < before]
        return min(at for at in falling if at >= moment - 2 * PERIOD_S), stood


def stops_within(stop: tuple[float, float], moment: float, latest_s: float) -> bool:
    """Whether it began to stop in time, and stood within its deceleration."""
    began, stood = stop
    return began - moment < latest_s + SLACK_S and stood - began < STOP_S + 3 * PERIOD_S + SLACK_S


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    """The plant of this module."""
    folder, port = tmp_path_factory.mktemp("hall"), system.free_tcp_port()
    with Processes() as processes, system.ros_domain() as domain:
        hall = Hall("ros2", domain, folder, system.free_multicast_url(), processes, None)
        server = {"port": port, "trust_all_clients": True}
        hall.fleet(server=server, deadman_s=DEADMAN_S, robot_timeout_s=DEADMAN_S)
        path = folder / "fleet.json"
        raw: dict[str, Any] = json.loads(path.read_text())
        fields = raw["robots"]["carrier"]["data"]["cmd_vel"]["fields"]
        fields["linear"]["unit"], fields["angular"]["unit"] = "m/s", "rad/s"
        path.write_text(json.dumps(raw))
        users = UserStore(folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
        users.path.parent.mkdir(parents=True, exist_ok=True)
        for user, role in ((OBSERVER, Role.OBSERVER), (OPERATOR, Role.OPERATOR), (ENGINEER, Role.ENGINEER)):
            users.add(*user, role)
        hall.start_robot()
        hall.start_bridge()

        def start_server() -> Child:
            child = processes.fork(ROOT / "tests" / "integration" / "run_server.py", path)
            child.wait_for("opc.tcp://")
            return child

        yield Plant(hall, f"opc.tcp://127.0.0.1:{port}/ua_fleet", start_server, start_server())


@pytest.fixture(scope="module")
def console(fleet: Plant, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """Its console."""
    with console_of(tmp_path_factory.mktemp("console"), {FLEET: fleet.endpoint}) as running:
        yield running


@pytest.fixture
def expected_complaints() -> list[str]:
    """A browser says so of each connection that fails."""
    return [
        "503",
        "ERR_CONNECTION_REFUSED",
        "ERR_CONNECTION_RESET",
        "ERR_EMPTY_RESPONSE",
        "/api/live",
        "/api/drive",
        "status of 4",
    ]


def acquire(page: Page) -> None:
    """Get the robot, as soon as nobody has it."""
    button = page.get_by_role("button", name="Drive", exact=True)
    expect(button).not_to_have_attribute("aria-disabled", "true", timeout=20_000)
    button.click()
    expect(page.get_by_role("dialog", name="You drive carrier")).to_be_visible()
    expect(page.get_by_role("application", name="Driving desk")).to_be_focused()


def at_the_desk(open_page: Open, role: str = "operator") -> Page:
    page = open_page(role, PLACE)
    acquire(page)
    return page


def no_longer(page: Page, why: str) -> None:
    expect(page.get_by_role("alert").filter(has_text=why)).to_be_visible()
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_keys_drive_as_long_as_they_are_held(fleet: Plant, open_page: Open, picture: Picture) -> None:
    page = open_page("operator", "#/hall/robot/carrier")
    page.get_by_role("link", name="Drive…").click()
    expect(page.get_by_role("heading", level=1, name="Drive carrier")).to_be_visible()
    expect(page.get_by_role("note")).to_contain_text("This is not a safety function.")
    expect(page.get_by_role("table", name="Limits")).to_contain_text("0.5 m/s")
    # Where it has to be scrolled, a keyboard can do it.
    expect(page.get_by_role("group", name="Limits")).to_have_attribute("tabindex", "0")
    expect(page.get_by_text("Nobody", exact=True)).to_be_visible()
    picture(page, "drive")
    acquire(page)
    page.keyboard.down("w")
    fleet.drives(HALF)
    page.keyboard.down("ArrowLeft")
    fleet.drives(HALF, 0.5)
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("0.25 m/s of 0.5 m/s")
    expect(dialog.get_by_text("Round trip").locator("xpath=following-sibling::dd")).to_have_text(MILLISECONDS)
    page.keyboard.up("ArrowLeft")
    fleet.drives(HALF)
    let_go = time.monotonic()
    page.keyboard.up("w")
    assert stops_within(fleet.stands_after(let_go), let_go, 2 * PERIOD_S)
    expect(dialog).to_contain_text("Yours")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.get_by_text("oscar: released")).to_be_visible()
    assert not page.get_by_role("alert").count()


def test_the_desk_is_seen_in_both_themes(fleet: Plant, open_page: Open, picture: Picture) -> None:
    page = at_the_desk(open_page)
    for _ in range(5):
        page.keyboard.down("w")
        fleet.drives(HALF)
        picture(page, "drive-desk")
        page.keyboard.up("w")
        if page.get_by_role("dialog", name="You drive carrier").is_visible():
            break
        # While a picture is taken and axe looks, the page stands; where a busy machine has it stand for as long as the
        # dead man's switch waits, it lets go of the robot, as it must, and the desk is gone.
        acquire(page)
    page.get_by_role("button", name="Stop and release").click()
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_speed_is_chosen_and_space_stops(fleet: Plant, open_page: Open) -> None:
    page = at_the_desk(open_page)
    for _ in range(3):
        page.keyboard.press("-")
    expect(page.get_by_text("Speed: 20 % of the limits")).to_be_visible()
    page.keyboard.down("s")
    fleet.drives(-0.2 * SPEED)
    at = time.monotonic()
    page.keyboard.press("Space")
    fleet.stands_after(at)
    page.keyboard.up("s")
    page.keyboard.press("Escape")


def test_nothing_is_driven_from_a_field(fleet: Plant, open_page: Open) -> None:
    page = at_the_desk(open_page)
    page.keyboard.down("w")
    fleet.drives(HALF)
    at = time.monotonic()
    page.get_by_role("slider").focus()
    fleet.stands_after(at)
    page.keyboard.up("w")
    at = time.monotonic()
    for key in ("ArrowUp", "w", "a"):
        page.keyboard.down(key)
    page.wait_for_timeout(500)
    assert not any(one.linear or one.angular for one in fleet.hall.speeds("heard", at))
    expect(page.get_by_text("Speed: 60 % of the limits")).to_be_visible()
    for key in ("ArrowUp", "w", "a"):
        page.keyboard.up(key)
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_a_key_whose_release_was_lost_is_released(fleet: Plant, open_page: Open) -> None:
    page = at_the_desk(open_page)
    pressed = time.monotonic()
    page.keyboard.down("w")
    page.keyboard.down("w")  # it repeats itself
    repeated = time.monotonic()
    fleet.until(lambda speeds: any(one.at > pressed and one.linear for one in speeds))
    fleet.stands_after(repeated)
    expect(page.get_by_role("dialog")).to_contain_text("Yours")
    page.keyboard.up("w")
    page.keyboard.press("Escape")


def test_a_mouse_drives_on_the_pad(fleet: Plant, open_page: Open) -> None:
    page = at_the_desk(open_page)
    box = page.locator(".pad").bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, box["y"] - 20, steps=4)
    fleet.drives(HALF)
    page.mouse.move(box["x"] + box["width"] + 30, y, steps=8)
    fleet.drives(0.0, -0.5)
    at = time.monotonic()
    page.mouse.up()
    fleet.stands_after(at)
    page.keyboard.press("Escape")


def test_a_finger_drives_on_a_small_screen(fleet: Plant, open_page: Open) -> None:
    page = open_page("operator", PLACE)
    page.set_viewport_size({"width": 360, "height": 740})
    acquire(page)
    box = page.locator(".pad").bounding_box()
    assert box
    assert box["y"] + box["height"] < 740, "the pad is seen without scrolling"
    devtools: Any = page.context.new_cdp_session(page)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def touch(kind: str, *points: tuple[float, float]) -> None:
        shown = [{"x": left, "y": top} for left, top in points]
        devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": shown})

    touch("touchStart", (x, y))
    touch("touchMove", (x, box["y"] - 5))
    fleet.drives(HALF)
    at = time.monotonic()
    touch("touchEnd")
    fleet.stands_after(at)
    expect(page.get_by_role("button", name="Stop and release")).to_be_in_viewport()
    page.get_by_role("button", name="Stop and release").click()


GAMEPAD: Final = """
navigator.getGamepads = () => [window.pad ?? null];
window.hold = (y, ...held) => window.pad = {
  id: 'Pad of the test', connected: true, mapping: 'standard', axes: [0, y, 0, 0],
  buttons: Array.from({length: 17}, (_, place) => ({pressed: held.includes(place)}))};
"""


def test_a_gamepad_drives_while_a_shoulder_button_is_held(fleet: Plant, open_page: Open) -> None:
    page = open_page("operator", PLACE)
    page.evaluate(GAMEPAD + "hold(-1, 4)")
    began = time.monotonic()
    acquire(page)
    expect(page.get_by_role("dialog")).to_contain_text("Pad of the test")
    page.wait_for_timeout(300)
    assert not any(one.linear for one in fleet.hall.speeds("heard", began)), "it was held down before"
    page.evaluate("hold(-1)")
    page.wait_for_timeout(100)
    page.evaluate("hold(-1, 4)")
    fleet.drives(HALF)
    at = time.monotonic()
    page.evaluate("hold(-1)")
    fleet.stands_after(at)
    page.evaluate("hold(1, 5)")
    fleet.drives(-HALF)
    at = time.monotonic()
    page.evaluate("window.pad = null")
    fleet.stands_after(at)
    no_longer(page, "the gamepad is gone")


@pytest.mark.parametrize("what", ["blur", "hidden", "freeze", "close", "go"])
def test_who_is_gone_has_stopped_and_released(fleet: Plant, open_page: Open, what: str) -> None:
    page, other = at_the_desk(open_page), open_page("observer", PLACE)
    expect(other.get_by_text("oscar drives", exact=True)).to_be_visible()
    page.keyboard.down("w")
    fleet.drives(HALF)
    at = time.monotonic()
    if what == "blur":
        page.evaluate("dispatchEvent(new Event('blur'))")
        no_longer(page, "the window has lost the focus")
    elif what == "freeze":
        page.evaluate("document.dispatchEvent(new Event('freeze'))")
        no_longer(page, "the browser has stopped the page")
    elif what == "hidden":
        page.evaluate(
            "Object.defineProperty(document, 'hidden', {value: true});"
            "document.dispatchEvent(new Event('visibilitychange'))"
        )
        no_longer(page, "the page was hidden")
    elif what == "close":
        page.close()
    else:
        page.evaluate("location.hash = '#/hall/fleet'")
    assert stops_within(fleet.stands_after(at), at, 4 * PERIOD_S)
    expect(other.get_by_text("Last: oscar: released")).to_be_visible()


def test_two_browsers_contend_and_an_engineer_takes_over(fleet: Plant, open_page: Open, picture: Picture) -> None:
    # Before anybody drives: to open a page may take a busy machine longer than the dead man's switch waits.
    second, observer, engineer = (open_page(role, PLACE) for role in ("operator", "observer", "engineer"))
    first = at_the_desk(open_page)
    for page in (second, observer):
        expect(page.get_by_text("oscar drives", exact=True)).to_be_visible()
        expect(page.get_by_role("button", name="Drive", exact=True)).to_have_attribute("aria-disabled", "true")
    expect(second.get_by_text("oscar drives it.")).to_be_visible()
    expect(second.get_by_text("Engineers may take it over.")).to_be_visible()
    expect(observer.get_by_text("Your role does not allow this; required role: Operator.")).to_be_visible()
    first.keyboard.down("w")
    fleet.drives(HALF)
    at = time.monotonic()
    engineer.get_by_role("button", name="Take over").click()
    expect(engineer.get_by_role("dialog", name="You drive carrier")).to_be_visible()
    no_longer(first, "oscar: taken over by erna")
    fleet.stands_after(at)
    first.keyboard.up("w")
    engineer.keyboard.down("s")
    fleet.drives(-HALF)
    expect(first.get_by_text("erna drives", exact=True)).to_be_visible()
    engineer.keyboard.up("s")
    engineer.keyboard.press("Escape")
    expect(engineer.get_by_role("dialog")).to_have_count(0)
    picture(first, "drive-taken-over")
    acquire(first)
    picture(observer, "drive-observer")
    first.keyboard.press("Escape")


def test_while_the_server_is_away_nobody_is_said_to_drive(fleet: Plant, open_page: Open, picture: Picture) -> None:
    idle, page = open_page("observer", PLACE), at_the_desk(open_page)
    expect(idle.get_by_text("oscar drives", exact=True)).to_be_visible()
    page.keyboard.down("w")
    fleet.drives(HALF)
    at = time.monotonic()
    fleet.server.end()
    assert stops_within(fleet.stands_after(at), at, DEADMAN_S + PERIOD_S)
    page.keyboard.up("w")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.get_by_role("alert").filter(has_text="You")).to_be_visible()
    for one in (idle, page):
        expect(one.get_by_role("status").filter(has_text="What is shown is not current.")).to_be_visible(timeout=20_000)
        who = one.get_by_role("region", name="Who drives")
        expect(who).to_contain_text("Not heard")
        expect(who.get_by_text(re.compile("^(oscar drives|Nobody|Being stopped)$"))).to_have_count(0)
        button = one.get_by_role("button", name="Drive", exact=True)
        expect(button).to_have_attribute("aria-disabled", "true")
    expect(page.get_by_role("button", name="Drive", exact=True)).to_have_attribute(
        "title", "What is shown is not current."
    )
    picture(page, "drive-away")
    fleet.server = fleet.start_server()
    expect(idle.get_by_text("Nobody", exact=True)).to_be_visible(timeout=30_000)
    acquire(page)
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_a_console_that_stands_or_is_killed_stops_the_robot(fleet: Plant, console: Console, open_page: Open) -> None:
    page = at_the_desk(open_page)
    page.keyboard.down("w")
    fleet.drives(HALF)
    at = time.monotonic()
    console.child.process.send_signal(signal.SIGSTOP)
    try:
        assert stops_within(fleet.stands_after(at), at, DEADMAN_S + PERIOD_S)
        no_longer(page, f"nothing was heard of it for {DEADMAN_S * 1000:.0f} ms")
    finally:
        console.child.process.send_signal(signal.SIGCONT)
    page.keyboard.up("w")
    acquire(page)
    page.keyboard.down("w")
    fleet.drives(HALF)
    at = time.monotonic()
    console.child.end(signal.SIGKILL)
    assert stops_within(fleet.stands_after(at), at, DEADMAN_S + PERIOD_S)
    no_longer(page, "the connection to the console is lost")
    console.start_again()
