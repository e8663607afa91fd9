"""What an `MqttTransport` carries: PubSub (`core.MqttCore`), or a Unified Namespace (`ua_fleet.uns`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from ua_fleet.counters import Drop
from ua_fleet.transport.mqtt.core import Heard, Outgoing

__all__ = ["Carried"]


class Carried(Protocol):
    """What the transport asks and tells it; `now` is monotonic seconds."""

    malformed: Counter[str]
    """What came and could not be read, by cause, since this was emptied last."""
    details: dict[str, str]
    """Of the last message of each cause, for the log."""

    @property
    def filters(self) -> Mapping[str, int]:
        """What to subscribe to, each with its QoS; nothing where nothing is to come in."""
        ...

    @property
    def status_topic(self) -> str | None:
        """Where the last will goes; None where there is none."""
        ...

    def will(self, now: float) -> bytes | None:
        """What the broker is to say when the connection breaks; None where that is not known yet."""
        ...

    def connected(self, now: float, receive_maximum: int = 65_535) -> None:
        """There is a connection, to a broker that takes so many messages in flight."""
        ...

    def disconnected(self) -> None:
        """There is none any more."""
        ...

    def received(self, topic: str, payload: bytes, now: float, *, is_retained: bool) -> Sequence[Heard]:
        """Take a message: what of it is handed on."""
        ...

    def late(self, now: float) -> Sequence[Heard]:
        """What was held back, and is handed on now."""
        ...

    def take(self, now: float) -> Iterator[Outgoing]:
        """What is to be sent now; to be used up at once."""
        ...

    def acknowledged(self, parcel: Any, *, is_refused: bool = False) -> None:
        """What was sent has arrived at the broker, or was refused there."""
        ...

    def poll(self, now: float) -> None:
        """What time has brought."""
        ...

    def clear_all(self, now: float) -> None:
        """The end, at a broker where nothing expires (MQTT 3.1.1)."""
        ...

    @property
    def is_empty(self) -> bool:
        """Whether everything was sent and acknowledged."""
        ...

    def is_stuck(self, now: float) -> bool:
        """Whether the broker does not acknowledge what it was sent."""
        ...

    def take_drops(self) -> dict[Drop, int]:
        """What was dropped since this was asked last."""
        ...

    def take_forgiven(self) -> Counter[str]:
        """What was forgiven since this was asked last, by name."""
        ...
