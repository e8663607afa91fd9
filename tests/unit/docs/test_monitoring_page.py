"""The page about monitoring: its table is that of the code, and its queries name metrics that there are."""

from __future__ import annotations

import re
from typing import Any

import yaml

from tests.unit.docs.pages import ROOT, blocks
from ua_fleet.counters import Drop
from ua_fleet.monitoring import METRICS
from ua_fleet.monitoring.metrics import MOST_ROBOTS, MOST_SKILLS
from ua_fleet.monitoring.reference import table

PAGE = ROOT / "docs" / "monitoring.md"


def prometheus() -> list[dict[str, Any]]:
    """The files of Prometheus that the page shows."""
    return [yaml.safe_load(block.text) for block in blocks("yml") if block.page == PAGE]


def test_the_table_is_that_of_the_code() -> None:
    assert f"\n{table()}\n" in PAGE.read_text(encoding="utf-8"), "put in: python -m ua_fleet.monitoring.reference"


def test_rules_ask_for_metrics_and_causes_that_there_are() -> None:
    config, alerts = prometheus()
    assert config["scrape_configs"][0]["static_configs"][0]["targets"]
    rules = alerts["groups"][0]["rules"]
    assert len(rules) >= 3
    known = {metric.name for metric in METRICS}
    for rule in rules:
        names = re.findall(r"ua_fleet_\w+", rule["expr"].replace('job="ua_fleet"', ""))
        assert names
        assert set(names) <= known
        for causes in re.findall(r'cause=~"([^"]+)"', rule["expr"]):
            assert set(causes.split("|")) <= {drop.value for drop in Drop}


def test_bounds_and_causes_in_the_text_are_those_of_the_code() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert f"the first {MOST_ROBOTS:,} robots and the first {MOST_SKILLS} names of skills" in text
    for cause in ("loop", "foreign", "own_publication", "repeated", "rate_limited", "unmapped"):
        assert f"`{cause}`" in text
        assert cause in set(Drop)
