"""What tests of scenarios do in the page."""

from __future__ import annotations

from playwright.sync_api import Locator, Page

from tests.console.conftest import Fleet

PLACE = "#/hall/scenarios"


def row(page: Page, name: str, table: str = "Library") -> Locator:
    return page.get_by_role("table", name=table).locator("tbody tr").filter(has_text=name).first


def chosen(page: Page, name: str, action: str) -> None:
    row(page, name).get_by_role("button", name=f"Actions for {name}").click()
    page.get_by_role("menuitem", name=action).click()


def text_of(page: Page, name: str) -> Locator:
    return page.get_by_role("textbox", name=f"Text of {name}")


def lines(page: Page) -> Locator:
    return page.get_by_role("list", name="Steps").get_by_role("listitem")


def stored(fleet: Fleet, name: str) -> str:
    return (fleet.plant.folder / "scenarios" / f"{name}.yaml").read_text().partition("steps:\n")[2]
