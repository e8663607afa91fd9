"""The page for PLC programmers: its table is that of its example."""

from __future__ import annotations

from tests.unit.docs.pages import ROOT, blocks
from ua_fleet.config.load import load_content
from ua_fleet.config.reference import put_between
from ua_fleet.modbus.table import markdown

PAGE = ROOT / "docs" / "plc.md"
BEGIN = "<!-- map: made by `ua-fleet modbus map` from the example above -->"
END = "<!-- end of the map -->"


def test_map_is_that_of_the_example() -> None:
    text = PAGE.read_text(encoding="utf-8")
    example = next(found.text for found in blocks("yaml") if found.page == PAGE)
    table = markdown(load_content(example.encode(), "fleet.yaml", {}))
    assert text == put_between(text, BEGIN, END, table), "put the output of `ua-fleet modbus map` into the page"
