"""The index of messages is current, tells a cause and a remedy for each, and has the lines that are really printed."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.unit.docs.pages import ROOT, script
from ua_fleet.cli.app import app
from ua_fleet.counters import Drop

PAGE = ROOT / "docs" / "troubleshooting.md"
ROW = re.compile(r"^\| `+ ?(?P<text>.+?) ?`+ \| (?P<cause>[^|]+) \| (?P<remedy>[^|]+) \|$", re.MULTILINE)


@pytest.fixture(scope="module")
def module() -> ModuleType:
    return script("troubleshooting")


@pytest.fixture(scope="module")
def sources(module: ModuleType) -> Any:
    return module.Sources()


@pytest.fixture(scope="module")
def rows() -> list[re.Match[str]]:
    index, _, _ = PAGE.read_text(encoding="utf-8").partition("## Lines of logs")
    return list(ROW.finditer(index))


def test_page_is_current(module: ModuleType, sources: Any) -> None:
    made = module.index(sources)
    assert f"{module.BEGIN}\n\n{made}\n\n{module.END}\n" in PAGE.read_text(encoding="utf-8"), (
        "run: python scripts/troubleshooting.py docs/troubleshooting.md"
    )


def test_each_message_has_a_cause_and_a_remedy(sources: Any, rows: list[re.Match[str]]) -> None:
    assert len(rows) > 500
    assert {message.error for message in sources.messages() if not message.remedy} == set()
    for row in rows:
        assert row["cause"].strip(), row[0]
        assert row["remedy"].strip(), row[0]


def found(rows: list[re.Match[str]], line: str) -> list[str]:
    """The messages of the index that a printed line has in it."""
    texts = {row["text"] for row in rows}
    return [text for text in texts if re.search(".*".join(re.escape(part) for part in text.split("…")), line)]


@pytest.mark.parametrize(
    ("arguments", "fixed"),
    [
        (["config", "check", "no.yaml"], "there is no such file"),
        (["config", "check", "fleet.yaml"], "unknown key"),
        (["bridge", "hall", "--config", "good.yaml"], "there is no bridge"),
        (["pubsub", "decode", "zz"], "hexadecimal"),
    ],
)
def test_lines_that_are_printed_are_in_it(
    rows: list[re.Match[str]], arguments: list[str], fixed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fleet.yaml").write_text("version: 1\npubsub: {security: none}\nrobotz: {}\n", encoding="utf-8")
    (tmp_path / "good.yaml").write_text("version: 1\npubsub: {security: none}\n", encoding="utf-8")
    ended = CliRunner().invoke(app, arguments, prog_name="ua-fleet")
    printed = f"{ended.output}\n{ended.exception}"
    assert any(fixed in text for line in printed.splitlines() for text in found(rows, line)), printed


def test_every_cause_of_a_drop_is_in_it() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [drop for drop in Drop if f"| `{drop.value}` |" not in text] == []


def test_texts_are_read_out_of_the_source(module: ModuleType, tmp_path: Path) -> None:
    package = tmp_path / "ua_fleet"
    package.mkdir()
    (package / "errors.py").write_text(
        'HELP = "call somebody"\n'
        'class UaFleetError(Exception):\n    """Base."""\n'
        'class Broken(UaFleetError):\n    """It is broken."""\n    remedy = "Mend it."\n'
        'class VeryBroken(Broken):\n    """It is very broken."""\n',
        encoding="utf-8",
    )
    (package / "machine.py").write_text(
        'raise Broken(f"machine {number} stands still: {why}")\n'
        'raise VeryBroken("the machine burns" if fire else "the machine smokes")\n'
        'raise VeryBroken(f"the machine is flooded; {HELP}")\n'
        'raise Broken(4, f"{number}: {why}")\n'
        'raise Stranger("of no interest to anybody")\n'
        '_log.warning("machine is too warm; open a window", degrees=3)\n'
        '_log.info("machine is pleasantly warm")\n',
        encoding="utf-8",
    )
    sources = module.Sources(tmp_path)
    assert [(one.text, one.remedy, one.error) for one in sources.messages()] == [
        ("machine … stands still: …", "Mend it.", "Broken"),
        ("the machine burns", "Mend it.", "VeryBroken"),
        ("the machine is flooded", "call somebody", "VeryBroken"),
        ("the machine smokes", "Mend it.", "VeryBroken"),
    ]
    assert [(one.text, one.remedy, one.level, one.fields) for one in sources.log_lines()] == [
        ("machine is too warm", "open a window", "warning", ("degrees",))
    ]
