# The parser of OpenMetrics has no types.
# pyright: reportUnknownVariableType=false
"""Metrics as a strict reader sees them."""

from __future__ import annotations

from urllib.request import Request, urlopen

from prometheus_client.openmetrics.parser import text_string_to_metric_families

__all__ = ["OPENMETRICS", "Samples", "samples", "scrape"]

OPENMETRICS = "application/openmetrics-text; version=1.0.0"

Samples = dict[tuple[str, ...], float]
"""Values by name and values of labels, these in the order of the labels' names."""


def samples(text: str) -> Samples:
    """All samples; raises ValueError where the text breaks a rule of OpenMetrics."""
    return {
        (sample.name, *[value for _, value in sorted(sample.labels.items())]): float(sample.value)
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def scrape(url: str) -> Samples:
    """What a process tells at `<url>/metrics`."""
    with urlopen(Request(f"{url}/metrics", headers={"Accept": OPENMETRICS}), timeout=10) as answer:
        assert answer.headers["Content-Type"].startswith(OPENMETRICS)
        return samples(answer.read().decode())
