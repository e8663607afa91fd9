"""Logging in and out, as a person does it."""

from __future__ import annotations

from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.console.conftest import TITLE
from tests.integration.server_model.harness import OPERATOR


def test_who_logs_in_sees_the_fleet(open_page: Callable[..., Page], picture: Callable[[Page, str], None]) -> None:
    page = open_page("")
    expect(page.get_by_role("heading", name="Log in")).to_be_visible()
    expect(page.get_by_text(TITLE)).to_be_visible()
    picture(page, "login")
    page.get_by_label("User").fill(OPERATOR[0])
    page.get_by_label("Password").fill(OPERATOR[1])
    page.keyboard.press("Enter")
    expect(page.get_by_role("link", name="Fleet", exact=True)).to_have_attribute("aria-current", "page")
    expect(page.get_by_role("article", name="middle")).to_be_visible()
    picture(page, "fleet")
