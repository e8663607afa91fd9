"""What sessions and subscriptions have been used for: the counters of their diagnostics (OPC 10000-5 12.9 to 12.15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

__all__ = ["SessionUsage", "SubscriptionUsage", "shortened"]

_MOST_TEXT: Final = 200
"""Of what a client says of itself no more is kept."""
_MOST_LOCALES: Final = 10
_MOST_USERS: Final = 10


def shortened(text: str | None) -> str:
    """As much of a client's text as is kept."""
    return (text or "")[:_MOST_TEXT]


@dataclass(slots=True)
class SessionUsage:
    """What a session says of its client, and how often its services were asked for."""

    name: str = ""
    product_uri: str = ""
    application_name: str = ""
    application_type: int = 1
    server_uri: str = ""
    endpoint_url: str = ""
    security_mode: int = 1
    security_policy: str = ""
    locales: Sequence[str] = ()
    connected_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    last_contact: datetime = field(default_factory=lambda: datetime.now(UTC))
    users: tuple[str, ...] = ()
    """Who has used it, one after the other."""
    by_certificate: bool = False
    """Whether its user has proved by a certificate who he is."""
    requests: int = 0
    refused: int = 0
    unauthorized: int = 0
    services: dict[int, list[int]] = field(default_factory=dict[int, list[int]])
    """Requests and refused ones of each service, by the identifier of the request's encoding."""

    def asked(self, kind: int) -> None:
        """A service is asked for."""
        self.last_contact = datetime.now(UTC)
        self.requests += 1
        self.services.setdefault(kind, [0, 0])[0] += 1

    def was_refused(self, kind: int, *, unauthorized: bool) -> None:
        """A request was answered with a fault."""
        if counts := self.services.get(kind):
            self.refused += 1
            counts[1] += 1
            self.unauthorized += unauthorized

    def speaks(self, locales: Sequence[str | None]) -> None:
        """The client has named its languages."""
        self.locales = tuple(shortened(locale) for locale in locales[:_MOST_LOCALES])

    def used_by(self, user: str, *, by_certificate: bool) -> None:
        """A user has activated the session."""
        self.by_certificate = by_certificate
        if self.users[-1:] != (user,):
            self.users = (*self.users, user)[-_MOST_USERS:]


@dataclass(slots=True)
class SubscriptionUsage:
    """How often something happened to a subscription."""

    modified: int = 0
    enabled: int = 0
    disabled: int = 0
    republish_requests: int = 0
    republished: int = 0
    transfer_requests: int = 0
    transferred_to_same: int = 0
    transferred_to_other: int = 0
    publish_requests: int = 0
    data_changes: int = 0
    events: int = 0
    late: int = 0
    discarded: int = 0
    """Messages that were forgotten before the client had acknowledged them."""
    overflows: int = 0
    event_overflows: int = 0
