"""What the Object PublishSubscribe says itself (OPC 10000-14 9.1.3.2)."""

from __future__ import annotations

from collections.abc import Sequence

from ua_fleet.operation.pubsub.description import Description, Diagnostics
from ua_fleet.wire.discovered import PubSubState

__all__ = ["describe_root"]


def describe_root(profiles: Sequence[str], diagnostics: Diagnostics) -> Description:
    """PublishSubscribe: its PubSubConnections are switched, and not itself.

    Args:
        profiles: transport profiles that this server speaks.
        diagnostics: of the whole.
    """
    return Description(
        "PublishSubscribeType",
        {
            "Status.State": int(PubSubState.OPERATIONAL),
            "SupportedTransportProfiles": list(profiles),
            **diagnostics.values(),
        },
    )
