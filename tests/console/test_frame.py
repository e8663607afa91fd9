"""What is around each page, when what it stands on goes: the server, the console, the login, a role."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console.conftest import FLEET, Console, Fleet, console_of, log_in
from tests.integration.scenarios.conftest import ENGINEER
from tests.integration.server_model.harness import OPERATOR
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
WAIT_MS = 30_000
"""A console waits up to 10 s before it tries again, and so does the page."""


@pytest.fixture
def expected_complaints() -> list[str]:
    """A browser says so of each connection that fails, and of refused requests."""
    return ["ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE", "/api/live", "status of 4"]


@pytest.fixture(autouse=True)
def _all_there(fleet: Fleet, console: Console) -> Iterator[None]:
    """A test that fails halfway leaves the others a server and a console."""
    yield
    if fleet.server.process.poll() is not None:
        fleet.server = fleet.plant.server_process()
    if console.child.process.poll() is not None:
        console.start_again()


def banner(page: Page, text: str) -> Locator:
    return page.get_by_role("status").filter(has_text=text)


def card(page: Page, robot: str) -> Locator:
    return page.get_by_role("article", name=robot)


def test_while_the_server_is_away_nothing_is_shown_as_live(page: Page, fleet: Fleet, picture: Picture) -> None:
    expect(card(page, "left")).to_contain_text("Idle")
    fleet.server.end()
    expect(banner(page, "No link to Hall 1.")).to_contain_text("What is shown is not current.", timeout=WAIT_MS)
    for robot in ("left", "middle", "right"):
        expect(card(page, robot)).to_contain_text("Was Idle")
    expect(page.get_by_role("button", name="Idle 3")).to_have_class(re.compile(r"\bwas\b"))
    picture(page, "frame-server-away")
    card(page, "left").get_by_role("button", name="Actions for left").click()
    expect(page.get_by_role("menuitem", name="Hold…")).to_have_attribute("aria-disabled", "true")
    page.keyboard.press("Escape")
    fleet.server = fleet.plant.server_process()
    expect(banner(page, "No link")).to_have_count(0, timeout=WAIT_MS)
    expect(card(page, "left")).to_contain_text(re.compile("(?<!Was )Idle"), timeout=WAIT_MS)


def test_while_the_console_stands_still_nothing_is_shown_as_live(
    page: Page, console: Console, picture: Picture
) -> None:
    """Its connection stays open, and only silence tells."""
    expect(card(page, "left")).to_contain_text("Idle")
    console.child.freeze()
    try:
        expect(banner(page, "The console cannot be reached")).to_be_visible(timeout=WAIT_MS)
        expect(card(page, "left")).to_contain_text("Was Idle")
    finally:
        console.child.go_on()
    expect(banner(page, "The console cannot")).to_have_count(0, timeout=WAIT_MS)
    expect(card(page, "left")).not_to_contain_text("Was")


def test_a_console_that_starts_anew_asks_who_it_is_and_goes_on_there(
    open_page: Open, console: Console, picture: Picture
) -> None:
    page = open_page("operator", "#/hall/fleet?view=rows&q=i")
    expect(page.get_by_role("table", name="Fleet")).to_be_visible()
    console.child.end()
    expect(banner(page, "The console cannot be reached")).to_be_visible(timeout=WAIT_MS)
    picture(page, "frame-console-away")
    console.start_again()
    expect(page.get_by_text("You were logged out. Log in again to continue.")).to_be_visible(timeout=WAIT_MS)
    picture(page, "frame-logged-out")
    page.get_by_label("User").fill(OPERATOR[0])
    page.get_by_label("Password").fill(OPERATOR[1])
    page.keyboard.press("Enter")
    expect(page.get_by_role("table", name="Fleet")).to_be_visible()
    expect(page.get_by_role("searchbox")).to_have_value("i")


def test_who_logs_out_is_logged_out_in_every_tab(open_page: Open, console: Console) -> None:
    console.states.pop("engineer", None)  # this login ends here
    page = open_page("engineer")
    second = page.context.new_page()
    second.goto(console.url)
    expect(card(second, "left")).to_be_visible()
    page.get_by_role("button", name="User erna").click()
    expect(page.get_by_text("Engineer", exact=True)).to_be_visible()
    page.get_by_role("menuitem", name="Log out").click()
    for one in (page, second):
        expect(one.get_by_role("heading", name="Log in")).to_be_visible()
    console.states.pop("engineer", None)


def test_a_wrong_password_is_said_once_and_typed_again(open_page: Open, picture: Picture) -> None:
    page = open_page("")
    page.get_by_label("User").fill(OPERATOR[0])
    page.get_by_label("Password").fill("wrong-password")
    page.keyboard.press("Enter")
    expect(page.get_by_role("alert")).to_contain_text("BadUserAccessDenied")
    expect(page.get_by_label("Password")).to_have_value("")
    picture(page, "login-refused")
    page.get_by_label("Password").fill(OPERATOR[1])
    page.keyboard.press("Enter")
    expect(page.get_by_role("navigation", name="Pages")).to_be_visible()


def test_a_role_that_is_taken_away_is_gone_without_a_reload(page: Page, fleet: Fleet) -> None:
    expect(card(page, "left")).to_be_visible()
    users = UserStore(fleet.plant.folder / fleet.plant.config.server.state_dir / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.add(*OPERATOR, Role.OBSERVER, replace_existing=True)
    try:
        page.get_by_role("button", name="User oscar").click()
        role = page.locator("[popover]:popover-open")
        ended = banner(page, "has ended").or_(page.get_by_text("You were logged out."))
        expect(role.get_by_text("Observer", exact=True).or_(ended)).to_be_visible(timeout=WAIT_MS)
    finally:
        users.add(*OPERATOR, Role.OPERATOR, replace_existing=True)


def test_a_theme_is_kept(page: Page, console: Console) -> None:
    page.emulate_media(color_scheme="light")
    page.get_by_role("button", name="Theme").click()
    expect(page.get_by_role("menuitemradio", name="As the system")).to_have_attribute("aria-checked", "true")
    page.get_by_role("menuitemradio", name="Dark").click()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    expect(card(page, "left")).to_be_visible()


def test_on_a_small_screen_pages_are_behind_a_button(page: Page, picture: Picture) -> None:
    page.set_viewport_size({"width": 360, "height": 740})
    expect(page.get_by_role("navigation", name="Pages")).to_be_hidden()
    page.get_by_role("button", name="Navigation").click()
    picture(page, "frame-navigation")
    page.set_viewport_size({"width": 360, "height": 740})
    page.get_by_role("link", name="Fleet", exact=True).click()
    expect(page.get_by_role("navigation", name="Pages")).to_be_hidden()


def test_an_address_that_is_no_page_says_so(open_page: Open, axe: Callable[[Page], None]) -> None:
    page = open_page("operator", "#/hall/nothing")
    expect(page.get_by_text("There is no page “nothing”.")).to_be_visible()
    axe(page)
    page.get_by_role("link", name="To the fleet").click()
    expect(card(page, "left")).to_be_visible()


def test_one_console_shows_several_fleets(
    fleet: Fleet, browser: object, open_page: Open, tmp_path_factory: pytest.TempPathFactory, picture: Picture
) -> None:
    with console_of(tmp_path_factory.mktemp("two"), {FLEET: fleet.endpoint, "yard": fleet.endpoint}) as two:
        page = open_page("")
        page.goto(two.url)
        expect(page.get_by_label("Fleet")).to_have_value("hall")
        log_in(page, two.url, "operator")
        expect(card(page, "left")).to_be_visible()
        page.get_by_role("button", name="Fleet: Hall 1. Choose another").click()
        page.get_by_role("menuitemradio", name="Log in at Yard…").click()
        expect(page.get_by_label("Fleet")).to_have_value("yard")
        picture(page, "login-fleets")
        page.get_by_label("User").fill(OPERATOR[0])
        page.get_by_label("Password").fill(OPERATOR[1])
        page.keyboard.press("Enter")
        expect(page).to_have_url(re.compile("#/yard/fleet$"))
        expect(card(page, "left")).to_be_visible()
        page.get_by_role("button", name="Fleet: Yard. Choose another").click()
        page.get_by_role("menuitemradio", name="Hall 1").click()
        expect(page).to_have_url(re.compile("#/hall/fleet$"))
        expect(card(page, "left")).to_be_visible()
        _another_person_logs_in(page)


OTHER_TAB: Final = """async ([what, body]) => {
  const {csrf} = await (await fetch('api/me')).json();
  const headers = {'Content-Type': 'application/json', 'X-CSRF': csrf};
  return (await fetch(`api/${what}`, {method: 'POST', headers, body: JSON.stringify(body)})).status;
}"""


def _another_person_logs_in(page: Page) -> None:
    """At one fleet, in another tab: this one has their name and rights, and none of what was begun before."""
    other = page.context.new_page()
    other.goto(page.url)
    expect(card(other, "left")).to_be_visible()
    card(page, "left").get_by_role("button", name="Actions for left").click()
    page.get_by_role("menuitem", name="Hold…").click()
    page.get_by_role("dialog").get_by_label("Reason").fill("oscar holds it")
    assert other.evaluate(OTHER_TAB, ["logout", {"fleet": "hall"}]) == 200
    expect(banner(page, "The session at Hall 1 has ended.")).to_be_visible()
    user, password = ENGINEER
    assert other.evaluate(OTHER_TAB, ["login", {"fleet": "hall", "user": user, "password": password}]) == 200
    for one in (page, other):
        expect(one.get_by_text(f"{user} has logged in at Hall 1 in another tab of this browser.")).to_be_visible()
        expect(one.get_by_role("button", name=f"User {user}")).to_be_visible()
        expect(one.get_by_role("dialog")).to_have_count(0)
        expect(card(one, "left")).to_contain_text(re.compile("(?<!Was )Idle"))
        expect(banner(one, "has ended")).to_have_count(0)
    page.get_by_role("button", name=f"User {user}").click()
    expect(page.get_by_text("Engineer", exact=True)).to_be_visible()
