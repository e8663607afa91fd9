"""Which values are kept: facts and their time in, rows out.

    same as the kept one   -> held: kept at the end of the flat part, or once `at_least_each_s` has passed
    another one            -> kept, after the one that is held; within `at_most_each_s` of a row the one that is held
                              goes, and the other one is due when that is over
    another quality, type  -> kept at once, after what waits

The times of a node's rows strictly increase. A row has the SourceTimestamp of its value. The server's time stands in
its place where that is no later than the row before (the same value becomes Bad, since its robot is silent), or where a
robot's clock is wrong. In the future: a series in disorder could not be read. Further back than rows are kept: it would
be removed at once.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Mapping
from itertools import count
from typing import Any, Final

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.history.rows import BAD_DATA_LOST, Row, is_number
from ua_fleet.history.rules import Rule
from ua_fleet.values import TICKS_PER_SECOND, NodeId

__all__ = ["Kept", "Recorder"]

Kept = tuple[NodeId, Row]
"""A row to store, and whose it is."""
MOST_AHEAD: Final = 60 * TICKS_PER_SECOND
"""How far a robot's clock may be ahead of the server's."""
_DAY: Final = 86_400 * TICKS_PER_SECOND


class _Node:
    """What is known of one node."""

    __slots__ = ("after", "due", "free_at", "held", "kept_at", "last", "listed", "rule")

    def __init__(self, rule: Rule, after: int) -> None:
        self.rule = rule
        self.last: Row | None = None
        """The row that was kept last by this process."""
        self.after = after
        """The time of the last row, whoever kept it."""
        self.held: Row | None = None
        """The last one that came since, and was not kept."""
        self.due: int | None = None
        """When that is to be kept, where it is another value."""
        self.kept_at = 0
        """When the last row was kept, by the server's clock."""
        self.free_at = 0
        """From which time on a row need not wait for `at_most_each_s`."""
        self.listed: int | None = None
        """For when it is in the list of those that are due: there once, however often another value came and went."""


class Recorder:
    """Decides for all nodes of a server. Times are ticks of the wall clock."""

    def __init__(
        self, rule_of: Callable[[NodeId], Rule | None], before: Mapping[NodeId, int] | None = None, stopped_at: int = 0
    ) -> None:
        """Go on with what is stored.

        Args:
            rule_of: what is kept of a node; None where nothing is.
            before: the time of the last row of each node that has any.
            stopped_at: when the last process that recorded them was last alive. What happened after that is not known,
                and marked so before the first row that follows.
        """
        self._rule_of = rule_of
        self._before = dict(before or {})
        self._stopped_at = stopped_at
        self._nodes: dict[NodeId, _Node | None] = {}
        self._due: list[tuple[int, int, NodeId]] = []
        self._order = count()

    def take(self, change: ValueChanged, wall: int) -> list[Kept]:
        """The rows that a change of a node's value makes."""
        key = change.key
        node = self._nodes.get(key)
        if node is None and (key in self._nodes or (node := self._first(key)) is None):
            return []
        row = Row(self._time(node, change.source_timestamp, wall), change.status, change.type, change.value)
        last, rule = node.last, node.rule
        if last is None:
            return self._keep(key, node, [*self._gap(key, row.time), row], wall)
        if row.status != last.status or row.type != last.type:
            return self._keep(key, node, [row] if node.held is None else [node.held, row], wall)
        if is_same(last, row, rule.deadband):
            node.due, node.held = None, row
            if rule.at_least_each_s and row.time - last.time >= rule.at_least_each_s * TICKS_PER_SECOND:
                return self._keep(key, node, [row], wall)
            return []
        if rule.at_most_each_s:
            return self._keep_seldom(key, node, row, wall)
        return self._keep(key, node, [row] if node.held is None else [node.held, row], wall)

    def put_behind(self, stored: Mapping[NodeId, int], stopped_at: int, waiting: Mapping[NodeId, int]) -> None:
        """Go on behind what a store has that was not known so far.

        Args:
            stored: the time of the last row of each node that it has.
            stopped_at: as at the start.
            waiting: the time of the last row of each node that waits for it.
        """
        self._stopped_at = stopped_at
        for key in {**stored, **waiting}:
            after = max(stored.get(key, -1), waiting.get(key, -1))
            node = self._nodes.get(key)
            if node is None:
                self._before[key] = max(after, self._before.get(key, -1))
                continue
            node.after = max(node.after, after)
            if node.held is not None and node.held.time <= node.after:
                node.held = node.held._replace(time=node.after + 1)

    def poll(self, wall: int) -> list[Kept]:
        """The rows of values that have waited for `at_most_each_s`."""
        kept: list[Kept] = []
        while self._due and self._due[0][0] <= wall:
            due, _, key = heapq.heappop(self._due)
            node = self._nodes.get(key)
            if node is None or node.listed != due:
                continue
            node.listed = None
            if node.due is None or node.held is None:
                continue
            if node.due > wall:
                self._list(key, node, node.due)
            else:
                kept += self._keep(key, node, [node.held], wall)
        return kept

    def next_due(self) -> int | None:
        """When `poll` is to be called next, or None."""
        return self._due[0][0] if self._due else None

    def finish(self) -> list[Kept]:
        """The last value of each node that was not kept, at the end: until then nothing else had happened."""
        kept: list[Kept] = []
        for key, node in self._nodes.items():
            if node is not None and node.held is not None:
                kept += self._keep(key, node, [node.held], node.kept_at)
        return kept

    def repeat(self, keys: Iterable[NodeId], wall: int) -> list[Kept]:
        """The values that nodes have now, of which rows were lost: otherwise one that stays as it is would be missing
        until it is another.
        """
        kept: list[Kept] = []
        for key in keys:
            node = self._nodes.get(key)
            if node is None or (row := node.held or node.last) is None:
                continue
            if row is not node.held:
                row = row._replace(time=max(wall, node.after + 1))
            kept += self._keep(key, node, [row], wall)
        return kept

    def forget(self, key: NodeId) -> list[Kept]:
        """A node is gone. Should one with its id come again, it goes on behind its last row.

        Returns:
            Its last value, where that was not kept.
        """
        node = self._nodes.get(key)
        kept = [] if node is None or node.held is None else self._keep(key, node, [node.held], node.kept_at)
        self._nodes.pop(key, None)
        if node is not None and node.after >= 0:
            self._before[key] = node.after
        return kept

    def _first(self, key: NodeId) -> _Node | None:
        rule = self._rule_of(key)
        node = self._nodes[key] = None if rule is None else _Node(rule, self._before.get(key, -1))
        return node

    def _time(self, node: _Node, source_timestamp: int | None, wall: int) -> int:
        last = node.after if node.held is None else node.held.time
        earliest = max(last + 1, wall - int(node.rule.days * _DAY))
        if source_timestamp is not None and earliest <= source_timestamp <= wall + MOST_AHEAD:
            return source_timestamp
        return max(wall, last + 1)

    def _gap(self, key: NodeId, time: int) -> list[Row]:
        """The mark that nothing is known from the end of the last process on, where a node has rows of it."""
        before = self._before.pop(key, None)
        if before is None:
            return []
        # Of a robot whose clock is behind, nobody knows when that was by its clock.
        at = self._stopped_at if before < self._stopped_at < time else before + 1
        return [Row(at, BAD_DATA_LOST, 0, None)] if at < time else []

    def _list(self, key: NodeId, node: _Node, due: int) -> None:
        """Have a node looked at when it is due, unless it is sooner."""
        if node.listed is None or due < node.listed:
            node.listed = due
            heapq.heappush(self._due, (due, next(self._order), key))

    def _keep_seldom(self, key: NodeId, node: _Node, row: Row, wall: int) -> list[Kept]:
        """Another value under `at_most_each_s`, after the end of a flat part: without that, a line would lead from the
        beginning of the flat part to this value.
        """
        kept: list[Kept] = []
        if node.due is None and node.held is not None and node.held.time >= node.free_at:
            kept = self._keep(key, node, [node.held], wall)
        if row.time >= node.free_at:
            return kept + self._keep(key, node, [row], wall)
        node.held = row
        if node.due is None:
            node.due = node.kept_at + _pause(node.rule)
            self._list(key, node, node.due)
        return kept

    def _keep(self, key: NodeId, node: _Node, rows: list[Row], wall: int) -> list[Kept]:
        node.last, node.after, node.held, node.due = rows[-1], rows[-1].time, None, None
        node.kept_at, pause = wall, _pause(node.rule)
        # One that has waited has the time at which it came, and the place of the one at which its pause was over.
        node.free_at = min(max(node.free_at, node.after), node.after + pause) + pause
        return [(key, row) for row in rows]


def _pause(rule: Rule) -> int:
    return int(rule.at_most_each_s * TICKS_PER_SECOND)


def is_same(last: Row, row: Row, deadband: float) -> bool:
    """Whether a value is the one that was kept, within a deadband."""
    before: Any = last.value
    value: Any = row.value
    if not is_number(row.type):
        return bool(before == value)
    if value != value or before != before:  # NaN is not itself, and yet the same again
        return bool(value != value and before != before)
    return bool(before == value or abs(value - before) <= deadband)
