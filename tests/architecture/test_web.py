"""`web/`: its types, form and texts, and that a page needs nothing which its Content-Security-Policy refuses."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from tests import system
from tests.console.browsing import WIDEST_PICTURES

WEB: Final = system.ROOT / "web"
SOURCES: Final = sorted(path for path in (WEB / "src").rglob("*") if path.suffix in (".ts", ".svelte"))
MOST_LINES: Final = 400
PAGES: Final = [path for path in SOURCES if path.suffix == ".svelte"]


def keys(part: dict[str, Any], above: str = "") -> Iterator[str]:
    for name, value in part.items():
        if isinstance(value, str):
            yield f"{above}{name}"
        else:
            yield from keys(value, f"{above}{name}.")


TEXTS: Final = list(keys(json.loads((WEB / "src" / "texts" / "en.json").read_text(encoding="utf-8"))))
_TEMPLATE = re.compile(r"`((?:[a-z0-9_]+\.)+[a-z0-9_]*(?:\$\{[^`}]*\}[a-z0-9_]*)+)`")
"""A key that is put together, as `link.${state}`."""


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(WEB / "src")))
def test_no_file_is_long(path: Path) -> None:
    """What is longer has parts that can stand by themselves."""
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES


@pytest.mark.needs("npm")
def test_web_s_own_tests_pass() -> None:
    """Vitest; prettier and svelte-check are a part of `make lint`."""
    command = [sys.executable, "scripts/web.py", "--run", "test"]
    done = subprocess.run(command, cwd=system.ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


def test_each_text_is_used() -> None:
    sources = "\n".join(path.read_text(encoding="utf-8") for path in SOURCES)
    built = [re.compile(re.sub(r"\\\$\\\{.*?\\\}", "[a-z0-9_]+", re.escape(one))) for one in _TEMPLATE.findall(sources)]
    assert [
        key
        for key in TEXTS
        if f"'{(plain := key.removesuffix('_one'))}'" not in sources and not any(one.fullmatch(plain) for one in built)
    ] == []


def test_texts_stand_in_their_order() -> None:
    """So that two who add some seldom meet in one line."""
    assert sorted(TEXTS, key=lambda key: key.split(".")) == TEXTS


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(WEB / "src")))
def test_no_text_stands_elsewhere(path: Path) -> None:
    """Words between tags, and attributes that people read or hear, come from en.json."""
    markup = path.read_text(encoding="utf-8")
    for block in (r"<script\b.*?</script>", r"<style\b.*?</style>", r"<!--.*?-->", r"&\w+;"):
        markup = re.sub(block, "", markup, flags=re.DOTALL)
    read = re.findall(r"\s(?:title|label|placeholder|alt|aria-label|text|help)=\"([^\"{]*[A-Za-z]{2}[^\"{]*)\"", markup)
    between = [
        words
        for part in re.split(r"<[^<>]*(?:=>[^<>]*)*>", _without_expressions(markup))
        if re.search(r"[A-Za-z]{2}", words := " ".join(part.split()))
    ]
    assert (read, between) == ([], [])


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(WEB / "src")))
def test_nothing_that_the_page_s_policy_refuses(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    found = re.findall(
        r"\{@html|\sstyle=\"|\sstyle=\{|innerHTML|\beval\(|new Function|javascript:|https?://[a-z]", text
    )
    assert found == []


def _without_expressions(markup: str) -> str:
    """Markup without what stands in braces, which may be nested."""
    kept: list[str] = []
    depth = 0
    for sign in markup:
        if sign == "{":
            depth += 1
        elif sign == "}":
            depth -= 1
        elif depth == 0:
            kept.append(sign)
    return "".join(kept)


def test_the_editor_completes_by_the_schema_that_is_published() -> None:
    schemas = (WEB / "src/pages/scenarios/scenario.schema.json", system.ROOT / "docs/schemas/scenario.schema.json")
    mine, published = (json.loads(path.read_text(encoding="utf-8")) for path in schemas)
    assert mine == published, f"copy {schemas[1]} to {schemas[0]}, and have prettier format it"


def test_the_lock_file_names_no_registry_and_has_hashes() -> None:
    locked = json.loads((WEB / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    assert len(locked) > 50
    for name, package in locked.items():
        if name and not package.get("link"):
            assert package.get("integrity", "").startswith("sha512-"), name
            assert package.get("resolved", "https://registry.npmjs.org/").startswith("https://registry.npmjs.org/")


def test_each_page_is_seen_at_the_greatest_width() -> None:
    pages = re.findall(r"^  \{ name: '(\w+)'", (WEB / "src" / "pages.ts").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(WIDEST_PICTURES) == sorted([*pages, "login"])
    tests = "".join(path.read_text(encoding="utf-8") for path in (system.ROOT / "tests" / "console").glob("test_*.py"))
    assert [name for name in WIDEST_PICTURES.values() if f', "{name}")' not in tests] == []


def test_a_theme_is_colours_alone() -> None:
    """So axe looks for the rest in one of them."""
    styles = {path: path.read_text(encoding="utf-8") for path in (*PAGES, *(WEB / "src" / "styles").glob("*.css"))}
    tokens = styles[WEB / "src" / "styles" / "tokens.css"]
    dark = re.findall(r"data-theme='dark'\] \{(.*?)\}", tokens, re.DOTALL)
    declared = re.findall(r"^\s*([\w-]+):\s*(.*?);$", "".join(dark), re.MULTILINE)
    assert len(declared) > 20
    is_colour = re.compile(r"#[0-9a-f]{6}|(?:0 \d+px \d+px )?rgb\([\d %/]+\)|dark")
    assert [name for name, value in declared if not is_colour.fullmatch(value)] == []
    asks = re.compile(r"data-theme|prefers-color-scheme|light-dark\(")
    assert {path.name: len(asks.findall(style)) for path, style in styles.items() if asks.search(style)} == {
        "tokens.css": 1
    }
    told = {path.name for path in SOURCES if "theme.shown" in path.read_text(encoding="utf-8")}
    assert told == {"ChartPanel.svelte", "ThemeMenu.svelte"}, "of which one draws anew and one has another picture"
