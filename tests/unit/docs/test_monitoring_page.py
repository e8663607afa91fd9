"""The page about monitoring: its table is that of the code, and its queries name metrics that there are."""

from __future__ import annotations

import json
import re

import pytest
import yaml

from tests.unit.docs.pages import ROOT, blocks
from ua_fleet.counters import Drop
from ua_fleet.monitoring import METRICS
from ua_fleet.monitoring.metrics import MOST_ROBOTS, MOST_SKILLS
from ua_fleet.monitoring.reference import table

PAGE = ROOT / "docs" / "monitoring.md"
FILES = ROOT / "docs" / "monitoring"


def expressions() -> dict[str, str]:
    """What alerts and panels ask for, by their names."""
    alerts = yaml.safe_load((FILES / "alerts.yml").read_text(encoding="utf-8"))
    asked = {rule["alert"]: rule["expr"] for group in alerts["groups"] for rule in group["rules"]}
    for panel in json.loads((FILES / "dashboard.json").read_text(encoding="utf-8"))["panels"]:
        asked |= {f"{panel['title']} {each['refId']}": each["expr"] for each in panel.get("targets", [])}
    return asked


def test_the_table_is_that_of_the_code() -> None:
    assert f"\n{table()}\n" in PAGE.read_text(encoding="utf-8"), "put in: python -m ua_fleet.monitoring.reference"


def test_the_page_names_what_prometheus_scrapes() -> None:
    (config,) = (yaml.safe_load(block.text) for block in blocks("yml") if block.page == PAGE)
    (job,) = config["scrape_configs"]
    assert job["static_configs"][0]["targets"]
    assert f'job="{job["job_name"]}"' in expressions()["UaFleetNotReady"]


@pytest.mark.parametrize(("name", "asked"), expressions().items())
def test_alerts_and_panels_ask_for_metrics_labels_and_causes_that_there_are(name: str, asked: str) -> None:
    known = {metric.name: metric for metric in METRICS}
    for family, labels in re.findall(r"((?:ua_fleet|process)_\w+)(?:{([^}]*)})?", asked.replace('job="ua_fleet"', "")):
        if family.startswith("process_"):  # of Prometheus's client library
            continue
        metric = known.get(family) or known[re.sub("_(bucket|count)$", "", family)]
        asked_for = set(re.findall(r"(\w+)(?:=|!)", labels)) - {"instance", "job"}
        assert asked_for <= set(metric.labels)
    for causes in re.findall(r'cause[=!]~"([^"]+)"', asked):
        assert set(causes.split("|")) <= {drop.value for drop in Drop}


def test_alerts_say_what_to_do() -> None:
    alerts = yaml.safe_load((FILES / "alerts.yml").read_text(encoding="utf-8"))
    for rule in (rule for group in alerts["groups"] for rule in group["rules"]):
        assert rule["labels"]["severity"] in ("page", "ticket", "watch")
        assert rule["annotations"].keys() == {"summary", "remedy"}


def test_bounds_and_causes_in_the_text_are_those_of_the_code() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert f"the first {MOST_ROBOTS:,} robots and the first {MOST_SKILLS} names of skills" in text
    for cause in ("loop", "foreign", "own_publication", "repeated", "rate_limited", "unmapped"):
        assert f"`{cause}`" in text
        assert cause in set(Drop)
