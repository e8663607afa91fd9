"""The mistakes of the server as nodes below Server/ServerStatus, where people look first.

An instance may have more components than its type (OPC 10000-3 6.2.2): ServerStatus gets `Mistakes` and `LastMistake`.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from asyncua.ua.object_ids import ObjectIds

from ua_fleet.endpoint.convert import data_value, raw_id
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.values import BuiltinType, NodeId

__all__ = ["MistakeNodes"]

PERIOD_S: Final = 1.0
_UINT64: Final = int(BuiltinType.UINT64)
_STRING: Final = int(BuiltinType.STRING)


class MistakeNodes:
    """Keeps these nodes true; called in time (`server.attached.Clock`)."""

    def __init__(
        self,
        parts: NodeFactory,
        mistakes: Mistakes,
        put: Callable[[ValueChanged], None],
        *,
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
    ) -> None:
        """Make the nodes.

        Args:
            parts: of the fleet's namespace; its values are those that `put` writes to.
            mistakes: the server's.
            put: has a value written.
            clock: monotonic seconds.
            wall_ticks: the time of the wall clock.
        """
        self._mistakes, self._put, self._clock, self._wall_ticks = mistakes, put, clock, wall_ticks
        self._keys = [NodeId(parts.ns, f"Server.{name}") for name in ("Mistakes", "LastMistake")]
        self._shown = 0
        self._next_at = clock()
        status, now = raw_id(ObjectIds.Server_ServerStatus), parts.now
        for key, name, kind, value in zip(
            self._keys, ("Mistakes", "LastMistake"), (_UINT64, _STRING), (0, ""), strict=True
        ):
            held = data_value(kind, value, 0, now, now)
            parts.variable(key, name, status, raw_id(kind), held, own_name=True)

    def due_in_s(self) -> float | None:
        """See Clock."""
        return max(self._next_at - self._clock(), 0.0)

    def poll(self) -> None:
        """See Clock."""
        if self._clock() < self._next_at:
            return
        self._next_at = self._clock() + PERIOD_S
        count = self._mistakes.count
        if count != self._shown:
            self._shown = count
            for key, kind, value in zip(self._keys, (_UINT64, _STRING), (count, self._mistakes.last), strict=True):
                self._put(ValueChanged(key, kind, value, 0, self._wall_ticks(), False))
