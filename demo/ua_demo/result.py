"""How one run of a demonstration ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

__all__ = ["DemoResult"]


@dataclass(slots=True)
class DemoResult:
    """What goes into the JSON file, what is printed, and whether it was as it should be."""

    report: dict[str, Any]
    lines: list[str]
    problems: list[str] = field(default_factory=list[str])
