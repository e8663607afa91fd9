"""What `ua-fleet pubsub probe` can ask for. It stands alone, since the command line needs it at once."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["HealthKind"]


class HealthKind(StrEnum):
    """What can be asked for."""

    METADATA = "metadata"
    WRITERS = "writers"
    GROUPS = "groups"
    CONNECTIONS = "connections"
    ENDPOINTS = "endpoints"
    APPLICATIONS = "applications"
    ACTIONS = "actions"
