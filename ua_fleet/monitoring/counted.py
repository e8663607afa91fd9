"""What every process on PubSub counts and has, as metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ua_fleet.counters import Counters, Drop
from ua_fleet.monitoring import metrics
from ua_fleet.monitoring.metrics import Family
from ua_fleet.transport.base import TransportStats

__all__ = ["counted", "keys_left", "transported"]


def counted(counters: Counters, *, has_space: bool) -> Iterator[Family]:
    """The counters of a process.

    Args:
        counters: the process's.
        has_space: whether it has a robot side, as bridges have.
    """
    yield metrics.RECEIVED.one(counters.messages_in)
    yield metrics.SENT.one(counters.messages_out)
    if has_space:
        yield metrics.FROM_SPACE.one(counters.from_space)
        yield metrics.TO_SPACE.one(counters.to_space)
    yield metrics.DROPS.many(((drop.value,), counters.drops[drop]) for drop in Drop)
    yield metrics.MALFORMED.many(((cause,), count) for cause, count in counters.malformed.items())
    yield metrics.FORGIVEN.many(((name,), count) for name, count in counters.forgiven.items())
    yield metrics.GAPS.one(counters.gaps)
    yield metrics.LOOPED.one(counters.looped)


def transported(stats: TransportStats) -> Iterator[Family]:
    """The figures of a transport; what the kernel dropped is among the drops."""
    yield metrics.DATAGRAMS_RECEIVED.one(stats.received)
    yield metrics.DATAGRAMS_SENT.one(stats.sent)
    yield metrics.RECEIVE_BUFFER.one(stats.receive_buffer_bytes)


def keys_left(last_s: Mapping[str, float], source_problem: str) -> Iterator[Family]:
    """The keys of message security.

    Args:
        last_s: for how many seconds the keys of each group are enough.
        source_problem: why the source of keys cannot be asked; empty while it can.
    """
    yield metrics.KEY_REMAINING.many(((group_id,), left_s) for group_id, left_s in last_s.items())
    yield metrics.KEY_SOURCE.one(not source_problem)
