from __future__ import annotations

import json

import pytest

from ua_fleet.cli.log_lines import readable


def test_a_line_of_a_log_is_made_for_people() -> None:
    line = json.dumps(
        {"event": "keys", "group": "t-2", "count": 5, "level": "info", "timestamp": "t", "bridge": "floor"}
    )
    assert readable(line) == ["info     keys group=t-2 count=5"]


def test_a_traceback_stands_below_its_line() -> None:
    line = json.dumps({"event": "a mistake", "level": "error", "exception": "Traceback:\n  in x"})
    assert readable(line) == ["error    a mistake", "Traceback:", "  in x"]


@pytest.mark.parametrize("line", ["ready: opc.tcp://x", "", "{", "{broken", "[1]", '{"ready": true}', "null"])
def test_any_other_line_stays(line: str) -> None:
    assert readable(line) == [line]


def test_a_line_of_another_program_may_have_anything_in_these_places() -> None:
    assert readable('{"event": 1, "level": null, "exception": null}') == ["         1"]
    assert readable('{"event": "x", "level": ["a"]}') == ["['a']    x"]
