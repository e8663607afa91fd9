"""What was seen becomes a table in a page, and what was bad a line."""

from __future__ import annotations

import pytest

from tests.testbed.healing import Row
from tests.testbed.ledger import Account
from tests.testbed.table import failures, into_page, lines

GOOD = Row("ROS master", "rosmaster", "killed", None, 1.26, account=Account(asked=7, done=7), gaps=0)
SLOW = Row("PLC", "conveyor", "paused", 3.14, None, ["no skill was done"], account=Account(9, 5, unknown=1, lost=1))


def test_the_table() -> None:
    assert lines([GOOD, SLOW], {"Docker": "20.10", "cores": "2"}) == [
        "Docker 20.10, cores 2.",
        "",
        "| what | | noticed | healed | commands | done | refused | failed | unknown | lost | doubled | late | gaps |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
        "| ROS master (`rosmaster`) | killed | - | 1.3 s | 7 | 7 | 0 | 0 | 0 | 0 | 0 | 0 | 0 |",
        "| PLC (`conveyor`) | paused 10 s | 3.1 s | **not in 60 s** | 9 | 5 | 0 | 0 | 1 | 1 | 0 | 0 | - |",
        "| **all** | | | | **16** | **12** | **0** | **0** | **1** | **1** | **0** | **0** | |",
    ]


def test_what_was_bad() -> None:
    assert failures([GOOD]) == []
    assert failures([SLOW]) == [
        "conveyor paused: not well after 60 s: no skill was done",
        "conveyor paused: 1 commands lost",
    ]
    late = Row("a", "a", "stopped", 1.0, 1.0, [], 0, ["b was Good"], Account(asked=1, late=1))
    assert failures([late]) == ["a stopped: 1 commands begun too late", "a stopped: b was Good"]
    assert failures([Row("a", "a", "killed", None, 1.0)]) == ["a killed: nothing was asked for meanwhile"]


def test_the_page_keeps_all_but_the_table() -> None:
    page = "before\n<!-- a -->\nold\n<!-- /a -->\nafter\n<!-- b -->\n<!-- /b -->\n"
    assert into_page(page, "a", ["new"]) == page.replace("old", "new")
    assert into_page(page, "b", ["new"]) == page.replace("<!-- b -->\n", "<!-- b -->\nnew\n")
    with pytest.raises(ValueError, match="<!-- c -->"):
        into_page(page, "c", ["new"])
