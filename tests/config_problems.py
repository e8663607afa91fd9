"""What a test's `fleet.yaml` is refused for."""

from __future__ import annotations

from ua_fleet.config.load import load_content
from ua_fleet.errors import ConfigInvalid

__all__ = ["problems"]


def problems(text: str) -> list[str]:
    """Its problems, from their lines on; none where it is valid."""
    try:
        load_content(text.encode(), "F", {})
    except ConfigInvalid as invalid:
        return [str(problem).removeprefix("F:") for problem in invalid.problems]
    return []
