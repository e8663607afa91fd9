"""Logging in and out, as a person does it."""

from __future__ import annotations

from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.console.conftest import TITLE, Console
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


def test_the_page_s_policy_lets_nothing_unsafe_in(console: Console, open_page: Callable[..., Page]) -> None:
    """A page that works under it shows that nothing needs more: what it refuses is a complaint, which fails a test."""
    page = open_page("operator")
    answer = page.goto(console.url)
    assert answer is not None
    told = answer.headers["content-security-policy"].split(";")
    policy = {name: value for name, _, value in (part.strip().partition(" ") for part in told)}
    assert policy["default-src"] == policy["script-src"] == policy["style-src"] == "'self'"
    assert [value for value in policy.values() if "unsafe" in value or "*" in value] == []
    assert policy["frame-ancestors"] == policy["object-src"] == "'none'"
    expect(page.get_by_role("article", name="left")).to_be_visible()
    loaded = page.evaluate("performance.getEntriesByType('resource').map(one => new URL(one.name).origin)")
    assert set(loaded) == {console.url.rstrip("/")}
