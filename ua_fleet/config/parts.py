"""The parts of a `fleet.yaml` that are valid by themselves, for the checks between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ua_fleet.config.schema import BridgeConfig, DataSetConfig, PubSubConfig, ResilienceConfig, RobotConfig
from ua_fleet.document import Document, KeyPath, as_mapping

__all__ = ["Parts"]


@dataclass(frozen=True, slots=True)
class Parts:
    """What is valid by itself; the rest has its problems already."""

    document: Document
    file: str
    pubsub: PubSubConfig | None
    bridges: dict[str, BridgeConfig]
    bridge_of: dict[str, str]
    """The bridge of each valid robot."""
    data: dict[tuple[str, str], DataSetConfig]
    """By robot and name."""
    robots: dict[str, RobotConfig]
    """Robots with their skills, without their data."""
    resilience: ResilienceConfig | None = None
    """With the criteria and faults that are valid; None for robots that stand in no file."""
    connections: tuple[tuple[KeyPath, PubSubConfig], ...] = ()
    """All that are valid by themselves, with where each stands."""

    def mapping_at(self, path: KeyPath) -> dict[str, Any]:
        """The mapping that stands at a path of the file; empty where there is none."""
        value = self.document.data
        for step in path:
            value = as_mapping(value.get(str(step))) or {}
        return value
