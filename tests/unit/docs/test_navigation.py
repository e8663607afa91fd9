"""The navigation of the site names every page once, and no page that nobody wrote: the generator says neither."""

from __future__ import annotations

import re

from tests.unit.docs.pages import ROOT

_PAGE = re.compile(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", re.MULTILINE)


def test_every_page_is_in_the_navigation_once() -> None:
    _, _, navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")
    named = _PAGE.findall(navigation)
    assert len(named) > 90
    written = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")}
    assert (set(named) - written, written - set(named)) == (set(), set())
    assert sorted(named) == sorted(set(named))


def test_every_decision_is_in_its_list() -> None:
    listed = (ROOT / "docs" / "adr" / "README.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs" / "adr").glob("0*.md"):
        assert f"]({page.name})" in listed, page.name
