"""A real server with three robots, a console, and a browser that is logged in.

One of each for a module: a test leaves the fleet as it found it, or says `fresh_fleet`.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pytest
from playwright.sync_api import Browser, Page, expect

from tests import computing, system
from tests.console import browsing
from tests.integration.scenarios.conftest import ENGINEER, ROBOTS, Plant
from tests.integration.server_model.harness import OBSERVER, OPERATOR
from tests.system import Child, Processes
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

USERS: Final = {"observer": OBSERVER, "operator": OPERATOR, "engineer": ENGINEER}
FLEET: Final = "hall"
TITLE: Final = "Hall 1"
PATIENCE_MS: Final = 60_000
"""For what a page shows, as for other facts; a busy machine needs more than Playwright's 5 s."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.nodeid.startswith("tests/console/"):
            item.add_marker(pytest.mark.needs("chromium"))


@dataclass
class Fleet:
    """A server as a process, and bridges of three machines with one skill `work`."""

    plant: Plant
    server: Child
    bridges: dict[str, Child] = field(default_factory=dict[str, Child])

    @property
    def endpoint(self) -> str:
        """Of the server."""
        return f"opc.tcp://127.0.0.1:{self.plant.config.server.port}/ua_fleet"


@dataclass
class Console:
    """A console as a process."""

    url: str
    child: Child
    folder: Path
    _processes: Processes
    states: dict[str, Any] = field(default_factory=dict[str, Any])
    """Cookies of users that are logged in, by their role."""

    def start_again(self) -> None:
        """Start it anew at the same address; it knows nobody then."""
        self.child.end()
        self.states.clear()
        self.child = _start_console(self._processes, self.folder)
        self.child.wait_for('"ready"')


def long_decisions(raw: dict[str, Any]) -> None:
    """On a busy machine a browser is at a decision for more than a minute."""
    raw["resilience"]["limit_s"] = 600


@contextmanager
def fleet_of(folder: Path, prepare: Callable[[Plant], None] = lambda plant: None) -> Generator[Fleet]:
    """The fleet while the context lasts; `prepare` changes its files before it begins."""
    with Processes() as processes:
        # Long enough that a busy machine makes no robot silent that nobody has ended.
        patient = {"receive_timeout_s": 3.0}
        plant = Plant(folder, system.free_multicast_url(), system.free_tcp_port(), processes, "operator", patient)
        plant.declare(long_decisions)
        plant.users()
        users = UserStore(folder / plant.config.server.state_dir / USERS_FILE, ScryptCost(2**8, 8, 1))
        users.add(*OBSERVER, Role.OBSERVER, replace_existing=True)
        prepare(plant)
        fleet = Fleet(plant, plant.server_process())
        for robot in ROBOTS:
            fleet.bridges[robot] = plant.start_bridge(robot)
        for child in fleet.bridges.values():
            child.wait_for("ready")
        yield fleet


def _start_console(processes: Processes, folder: Path) -> Child:
    return processes.start(
        *(Path(sys.executable), "-m", "ua_fleet.cli", "console", "--config", folder / "console.yaml", "--json")
    )


@contextmanager
def console_of(folder: Path, endpoints: dict[str, str]) -> Generator[Console]:
    """A console of fleets while the context lasts."""
    port = system.free_tcp_port()
    settings = {
        "listen": f"127.0.0.1:{port}",
        "fleets": {
            name: {"endpoint": endpoint, "title": TITLE if name == FLEET else name.title()}
            for name, endpoint in endpoints.items()
        },
        "state_dir": str(folder / "state"),
    }
    (folder / "console.yaml").write_text(json.dumps(settings), encoding="utf-8")
    with Processes() as processes:
        child = _start_console(processes, folder)
        child.wait_for('"ready"')
        yield Console(f"http://127.0.0.1:{port}/", child, folder, processes)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """The fleet of this module."""
    with fleet_of(tmp_path_factory.mktemp("fleet")) as running:
        yield running


@pytest.fixture(scope="module")
def console(fleet: Fleet, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """The console of this module, which knows its fleet as `hall`."""
    with console_of(tmp_path_factory.mktemp("console"), {FLEET: fleet.endpoint}) as running:
        yield running


@pytest.fixture(scope="module", autouse=True)
def _patience() -> Iterator[None]:
    expect.set_options(timeout=PATIENCE_MS)
    yield
    expect.set_options(timeout=5_000)


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """One Chromium for all modules here that run one after the other."""
    # Playwright's loop is its own; what pytest-asyncio left behind for this thread is none that runs.
    asyncio.set_event_loop(None)
    with browsing.chromium("--renderer-process-limit=1") as running:
        yield running


@pytest.fixture(scope="module")
def windows(browser: Browser) -> Iterator[browsing.Windows]:
    """What the pages of this module's tests are opened in."""
    used = browsing.Windows(browser, PATIENCE_MS)
    yield used
    computing.note_browsers()
    used.close()


def log_in(page: Page, url: str, role: str) -> None:
    """Log in as people do."""
    user, password = USERS[role]
    page.goto(url)
    page.get_by_label("User").fill(user)
    page.get_by_label("Password").fill(password)
    page.get_by_role("button", name="Log in").click()
    page.get_by_role("navigation", name="Pages").wait_for(state="attached")


@pytest.fixture
def expected_complaints() -> list[str]:
    """Parts of what this test expects the page to complain about, as of a console that is away."""
    return []


@pytest.fixture
def open_page(
    console: Console, windows: browsing.Windows, expected_complaints: list[str]
) -> Iterator[Callable[..., Page]]:
    """`open_page('operator', '#/hall/fleet')`: a page in a browser of its own, logged in; '' as the role: nobody."""
    complaints: list[browsing.Complaints] = []

    def opened(role: str = "operator", place: str = "") -> Page:
        page = windows.open(console.states.get(role, ()))
        complaints.append(browsing.Complaints(page))
        if role and role not in console.states:
            log_in(page, console.url, role)
            console.states[role] = page.context.cookies()
        page.goto(f"{console.url}{place}")
        return page

    yield opened
    windows.leave(console.url)
    assert [one for each in complaints for one in each.others_than(expected_complaints)] == []


@pytest.fixture
def page(open_page: Callable[..., Page]) -> Page:
    """The console's page, with an operator logged in."""
    return open_page("operator")


@pytest.fixture
def axe() -> Callable[[Page], None]:
    """`axe(page)`: axe finds nothing on what is shown now."""

    def check(page: Page) -> None:
        assert browsing.axe_violations(page) == []

    return check


@pytest.fixture
def picture() -> Callable[[Page, str], None]:
    """`picture(page, 'fleet')`: what is shown now is right in both themes and all widths; axe finds nothing there."""

    def kept(page: Page, name: str) -> None:
        assert browsing.pictures(page, name) == []

    return kept
