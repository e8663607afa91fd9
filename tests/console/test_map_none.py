"""The map of a fleet whose robots do not say where they are says what would make them."""

from __future__ import annotations

from collections.abc import Callable

from playwright.sync_api import Page, expect


def test_what_to_do_is_said(open_page: Callable[..., Page], picture: Callable[[Page, str], None]) -> None:
    page = open_page("observer", "#/hall/map")
    expect(page.get_by_text("No robot reports a position.")).to_be_visible()
    expect(page.get_by_text("data named pose")).to_be_visible()
    picture(page, "map-none")
