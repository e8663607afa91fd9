"""The site builds without a warning, and its pages need nothing from elsewhere."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests.docs.site import build_fails
from tests.unit.docs.pages import ROOT

_LOADED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*?\bsrc=\"?([^\" >]+)|<link\b[^>]*?\bhref=\"?([^\" >]+)[^>]*>"
)


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 30
    loaded = {one or other for page in pages for one, other in _LOADED.findall(page.read_text(encoding="utf-8"))}
    assert any(name.endswith("assets/iframe-worker.js") for name in loaded), "the search needs it in a folder"
    assert {name for name in loaded if re.match(r"(\w+:)?//", name)} == set()
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(\s*['\"]?(https?:)?//", sheet.read_text(encoding="utf-8")), sheet


def test_a_page_is_found_by_its_words(site: Path) -> None:
    index = (site / "search.js").read_text(encoding="utf-8")
    assert "MessageReceiveTimeout" in index


def test_lists_and_tables_are_such(site: Path) -> None:
    """The generator takes a list for text where no empty line is before it."""
    for page in site.rglob("*.html"):
        text = re.sub(r"<pre>.*?</pre>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for paragraph in re.findall(r"<p>.*?</p>", text, re.DOTALL):
            assert not re.search(r"\n(\* |\d\. |\|)", paragraph), f"{page.name}: {paragraph}"


@pytest.mark.parametrize("link", ["gone.md", "console.md#gone", "../README.md", "/console.md"])
def test_a_link_that_leads_nowhere_fails_the_build(tmp_path: Path, link: str) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(f"# Pages\n\n[there]({link})\n", encoding="utf-8")
    (tmp_path / "docs" / "console.md").write_text("# Console\n", encoding="utf-8")
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("nav:\n")[0]
    (tmp_path / "mkdocs.yml").write_text(f"{settings}nav:\n  - index.md\n  - console.md\n", encoding="utf-8")
    shutil.copytree(ROOT / "docs" / "assets", tmp_path / "docs" / "assets")
    assert "does not exist" in build_fails(tmp_path)


def test_each_page_leads_to_its_neighbours(site: Path) -> None:
    tutorial = (site / "tutorial.html").read_text(encoding="utf-8")
    assert {"Previous", "Next"} <= set(re.findall(r"md-footer__link--\w+\" aria-label=\"(\w+):", tutorial))


def test_commands_and_files_are_coloured(site: Path) -> None:
    tutorial = (site / "tutorial.html").read_text(encoding="utf-8")
    assert re.search(r'class="language-sh highlight">.*?<span class="w">', tutorial, re.DOTALL)
    assert re.search(r'class="language-ya?ml highlight">.*?<span class="nt">', tutorial, re.DOTALL)
