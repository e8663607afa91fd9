"""The diagrams are those that the script draws, each text fits into its place, and each kind of bridge has one."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import pytest

from tests.unit.docs.pages import PAGES, ROOT, script
from ua_fleet.config.kinds import known_kinds

ASSETS = ROOT / "docs" / "assets"


@pytest.fixture(scope="module")
def diagrams() -> ModuleType:
    return script("diagrams")


def test_files_are_current(diagrams: ModuleType, tmp_path: Path) -> None:
    diagrams.main([str(tmp_path)])
    drawn = sorted(tmp_path.iterdir())
    assert len(drawn) >= 7
    for file in drawn:
        ET.parse(file)
        assert file.read_text(encoding="utf-8") == (ASSETS / file.name).read_text(encoding="utf-8"), (
            "run: python scripts/diagrams.py docs/assets"
        )


def test_each_text_fits(diagrams: ModuleType) -> None:
    for diagram in diagrams.DIAGRAMS.values():
        for part in diagram.parts:
            if isinstance(part, diagrams.Band):
                assert diagrams.text_width(part.place, 12) < 480 - 4 * 12
                for box in part.boxes:
                    assert diagrams.text_width(box.title, 14) < diagrams.box_width(part), box.title
                    assert all(diagrams.text_width(line, 12) < diagrams.box_width(part) for line in box.lines), box
            else:
                beside = part.data and part.commands
                assert all(diagrams.text_width(line, 12) < (204 if beside else 420) for line in part.data), part
                assert all(diagrams.text_width(line, 12) < 204 for line in part.commands), part


def test_each_kind_of_bridge_has_one_in_a_page() -> None:
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for kind in known_kinds():
        assert f"assets/bridge-{kind}.svg)" in shown, kind
    assert "assets/system.svg)" in shown
