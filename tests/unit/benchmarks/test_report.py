"""The results' way into docs/benchmarks.md."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import report
from benchmarks.__main__ import groups
from benchmarks.harness import at_least, at_most, shown

FIGURES = [
    at_least("codec: encode", 0.5, "us", reference="asyncua 2.1.0", reference_value=20.0, goal=30.0),
    at_most("ros: p50", 3.0, "us", reference="floor", reference_value=1.0, goal=2.0),
    shown("server: to a node", 400.0, "us", reference="floor", reference_value=200.0),
]
TABLE = """\
| figure | value | reference | ratio | goal | holds |
|---|---|---|---|---|---|
| codec: encode | 0.5 us | 20 us (asyncua 2.1.0) | 40.00 | 30 | yes |
| ros: p50 | 3 us | 1 us (floor) | 3.00 | 2 | **no** |
| server: to a node | 400 us | 200 us (floor) | 2.00 |  | yes |"""


def test_results_are_put_between_the_markers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results, page = tmp_path / "results.json", tmp_path / "benchmarks.md"
    monkeypatch.setattr(report, "RESULTS", results)
    monkeypatch.setattr(report, "PAGE", page)
    assert report.main() == 1
    results.write_text(json.dumps([figure._asdict() for figure in FIGURES]))
    page.write_text(f"# Page\n\n{report.BEGIN}\nold\n{report.END}\n\nrest\n")
    for _ in range(2):
        assert report.main() == 0
        assert page.read_text() == f"# Page\n\n{report.BEGIN}\n\n{TABLE}\n\n{report.END}\n\nrest\n"


def test_page_has_the_markers_and_every_group() -> None:
    text = report.PAGE.read_text()
    assert text.index(report.BEGIN) < text.index(report.END)
    for group in groups():
        assert f"### `{group}`" in text
    assert "report" not in groups()
