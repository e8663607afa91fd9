"""Walks find what a page says wrongly, and every block of a walked page says what it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import system
from tests.docs.walkthrough import KINDS, PASSWORD, Walk, blocks_without_mark, missing_line, plain_commands, steps
from tests.unit.docs.pages import ROOT

PAGES = ROOT / "docs"
WALKED = [ROOT / "README.md", PAGES / "index.md", PAGES / "tutorial.md", *sorted((PAGES / "how-to").glob("*.md"))]


@pytest.mark.parametrize("page", [pytest.param(page, id=page.name) for page in WALKED])
def test_every_block_says_what_it_is(page: Path) -> None:
    assert blocks_without_mark(page) == []
    found = list(steps(page))
    assert {step.kind for step in found} <= KINDS
    for step in found:
        if step.kind == "tested":
            assert (ROOT / step.detail).is_file(), f"{step.place}: there is no {step.detail}"


def walk(tmp_path: Path, processes: system.Processes, page: str, **instead: str) -> None:
    (tmp_path / "page.md").write_text(page, encoding="utf-8")
    Walk(tmp_path, processes, {}, instead).walk(tmp_path / "page.md")


def block(mark: str, text: str) -> str:
    return f"<!-- {mark} -->\n```\n{text}\n```\n\n"


def test_a_walk_does_what_the_page_says(tmp_path: Path, processes: system.Processes) -> None:
    page = block("file: a/greeting.txt", "hello") + block("append: a/greeting.txt", "here")
    page += block("run", "cat a/greeting.txt") + block("shows", "h…o\nhere")
    page += block("fails: 3", "echo no; exit 3") + block("shows", "no")
    page += block("terminal: talker, until: ready", "echo ready; sleep 60") + block("shows: talker", "ready")
    page += block("watch, ends: talker", "echo one; sleep 0.2; echo two; sleep 60") + block("shows", "one\ntwo")
    page += block("types password", "read -p 'word: ' word; echo $word > word.txt")
    walk(tmp_path, processes, page, here="there")
    assert (tmp_path / "word.txt").read_text(encoding="utf-8") == f"{PASSWORD}\n"


def test_commands_that_need_no_shell_are_run_as_a_shell_would(tmp_path: Path, processes: system.Processes) -> None:
    (tmp_path / "say.py").write_text("import os, sys\nprint(os.getcwd(), sys.argv[1:], os.environ.get('WHO'))\n")
    lines = "WHO='me and you' python say.py 'a b' c  # says it\n\npython say.py\npython gone.py\npython say.py never"
    walk(tmp_path, processes, block("fails: 1", lines))
    said = f"{tmp_path} ['a b', 'c'] me and you\n{tmp_path} [] None"
    walk(tmp_path, processes, block("run", lines.partition("\npython gone")[0]) + block("shows", said))
    walk(tmp_path, processes, block("run", "ua-fleet --version") + block("shows", "ua-fleet …"))
    page = (
        block("terminal: one, until: []", "python say.py") + block("watch", "python say.py x") + block("shows", "…x…")
    )
    walk(tmp_path, processes, page)


@pytest.mark.parametrize(
    "text", ["ua-fleet up & true", "python say.py $HOME", "ua-fleet read *", "ua-fleet up\ncat a", "# nothing"]
)
def test_what_needs_a_shell_gets_one(text: str) -> None:
    assert plain_commands(text) is None


@pytest.mark.parametrize(
    "page",
    [
        block("run", "false"),
        block("run", "false | cat"),
        block("fails: 2", "exit 1"),
        block("run", "python -m nothing_that_there_is"),
        block("run", "ua-fleet --version") + block("shows", "another"),
        block("run", "echo b; echo a") + block("shows", "a\nb"),
        block("terminal: talker, until: ready", "echo not yet"),
        block("shout", "hello"),
    ],
)
def test_a_walk_finds_what_is_wrong(tmp_path: Path, processes: system.Processes, page: str) -> None:
    with pytest.raises(AssertionError):
        walk(tmp_path, processes, page)


def test_what_stands_no_more_in_a_page_is_not_replaced_in_silence(tmp_path: Path, processes: system.Processes) -> None:
    with pytest.raises(AssertionError, match="'5020'"):
        walk(tmp_path, processes, block("run", "true"), **{"5020": "1"})


def test_lines_are_looked_for_in_their_order() -> None:
    assert missing_line("a …\nc", "x\na 1\nb\nc  ") is None
    assert missing_line("a …\nb", "b\na 1") == "b"
    assert missing_line("a", "ab") == "a"
