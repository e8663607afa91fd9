"""How long a process waits for a broker: one that is a cluster needs longer.

Where a node of a cluster dies, the others have to choose who leads. nats-server needs up to 9 s for that, and answers
nothing meanwhile: neither acknowledgements, nor pings behind what is not acknowledged. To leave it then and to begin
anew at the next node would only give it more to do.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Patience"]


class Patience(NamedTuple):
    """Times of one connection."""

    answer_s: float
    """For each answer: to CONNECT, SUBSCRIBE, PINGREQ and to a message."""
    ordered_s: float
    """So long values wait in their order; beyond that an older one goes for a newer one of its source."""

    @classmethod
    def of(cls, answer_s: float | None, ordered_s: float | None, *, is_cluster: bool) -> Patience:
        """What was asked for, and the rest as it fits one broker or a cluster."""
        usual = cls(20.0, 30.0) if is_cluster else cls(5.0, 2.0)
        return cls(
            usual.answer_s if answer_s is None else answer_s, usual.ordered_s if ordered_s is None else ordered_s
        )
