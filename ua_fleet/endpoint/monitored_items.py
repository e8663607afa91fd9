"""The monitored items of one subscription: which there are, what they watch, and how they go together."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import contextlib
import heapq
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.compact_nodes import HeldValue, Shared
from ua_fleet.endpoint.monitoring import DataItem, EventItem, Item
from ua_fleet.endpoint.stack import GOOD, StatusCodes, status
from ua_fleet.endpoint.turns import TURN_S

__all__ = ["MonitoredItems"]

_SPARE_SAMPLES: Final = 64
_KEPT: Final = (HeldValue, Shared)
"""What keeps the bytes of its value; others compute it."""


class MonitoredItems:
    """The items of one subscription; asyncua gives it the events."""

    def __init__(self, aspace: AddressSpace, failed: Callable[[Exception], None]) -> None:
        self._aspace, self._failed = aspace, failed
        self._monitored_items: dict[int, Item] = {}
        self._by_node: dict[ua.NodeId, dict[int, EventItem]] = {}
        self._watched: Counter[ua.NodeId] = Counter()
        self._last_id = 0
        self._triggering: dict[int, Item] = {}
        self._fired: dict[int, Item] = {}
        self._links = 0
        self._removed = False
        """Whether items have been removed since links were counted."""
        self._samples: list[tuple[float, int]] = []
        """When samples are due of items that hold a value, the first one first."""

    def __len__(self) -> int:
        return len(self._monitored_items)

    def __iter__(self) -> Any:
        return iter(list(self._monitored_items.values()))

    def get(self, item_id: int) -> Item | None:
        """An item by its id."""
        return self._monitored_items.get(item_id)

    def next_id(self) -> int:
        """The id of the next item."""
        self._last_id += 1
        return self._last_id

    @property
    def event_items(self) -> int:
        """Items that watch events."""
        return sum(map(len, self._by_node.values()))

    @property
    def filter_steps(self) -> int:
        """Steps that the filters of these items take for one event."""
        return sum(item.filter.cost for items in self._by_node.values() for item in items.values())

    def on(self, node_id: ua.NodeId) -> int:
        """Items that watch a node."""
        return self._watched[node_id]

    def add_data(self, item: DataItem) -> ua.StatusCode:
        """Watch a node's attribute, and tell its value as it is now."""
        result, item.handle = self._aspace.add_datachange_callback(item.node_id, item.attribute, item.changed)
        if result.is_good():
            self._monitored_items[item.id] = item
            self._watched[item.node_id] += 1
            node = self._aspace.get(item.node_id)
            held: Any = node.attributes.get(item.attribute) if node is not None else None
            item.source = held if type(held) in _KEPT else None
            item.tell_again()
        return result

    def add_events(self, item: EventItem) -> None:
        """Watch the events of a node."""
        self._monitored_items[item.id] = item
        self._watched[item.node_id] += 1
        self._by_node.setdefault(item.node_id, {})[item.id] = item

    def remove(self, item_id: int) -> Item | None:
        """Stop watching."""
        item = self._monitored_items.pop(item_id, None)
        if item is not None:
            item.clear()
            if self._triggering.pop(item_id, None) is not None:
                self._links -= len(item.links or ())
                self._fired.pop(item_id, None)
            self._removed = True
            self._watched[item.node_id] -= 1
            if not self._watched[item.node_id]:
                del self._watched[item.node_id]
        if isinstance(item, DataItem):
            # The node, and the callback with it, may have been deleted.
            with contextlib.suppress(KeyError):
                self._aspace.delete_datachange_callback(item.handle)
        elif isinstance(item, EventItem):
            others = self._by_node[item.node_id]
            del others[item_id]
            if not others:
                del self._by_node[item.node_id]
        return item

    def remove_all(self) -> None:
        """Stop watching everything."""
        for item_id in list(self._monitored_items):
            self.remove(item_id)

    def hold(self, item: DataItem) -> None:
        """A value waits until the next sample of its item is due."""
        heapq.heappush(self._samples, (item.due, item.id))
        if len(self._samples) > 2 * len(self._monitored_items) + _SPARE_SAMPLES:
            # Items that were removed, disabled or modified have left entries behind.
            data = (each for each in self._monitored_items.values() if isinstance(each, DataItem))
            self._samples = [(each.due, each.id) for each in data if each.holds]
            heapq.heapify(self._samples)

    def sample(self, now: float) -> bool:
        """Look at the values whose time has come, for one turn; whether there may be more of them."""
        began = time.monotonic()
        while self._samples and self._samples[0][0] <= now:
            item = self._monitored_items.get(heapq.heappop(self._samples)[1])
            if isinstance(item, DataItem):
                item.sample(now)
            if time.monotonic() - began > TURN_S:
                return True
        return False

    def add_link(self, triggering: Item, linked_id: int, most: int) -> ua.StatusCode:
        """Have an item reported when another one has a notification; at most so many links in all."""
        if linked_id not in self._monitored_items:
            return status(StatusCodes.BadMonitoredItemIdInvalid)
        links = triggering.links or {}
        if linked_id not in links:
            if self._links >= most:
                self._forget_links()
            if self._links >= most:
                return status(StatusCodes.BadTooManyMonitoredItems)
            links[linked_id] = None
            self._links += 1
            triggering.links = links
            self._triggering[triggering.id] = triggering
        return GOOD

    def remove_link(self, triggering: Item, linked_id: int) -> ua.StatusCode:
        """Undo `add_link`."""
        if triggering.links is None or linked_id not in triggering.links:
            return status(StatusCodes.BadMonitoredItemIdInvalid)
        del triggering.links[linked_id]
        self._links -= 1
        return GOOD

    def _forget_links(self) -> None:
        """Forget the links to items that are gone, if there can be any."""
        if not self._removed:
            return
        self._removed = False
        for item in self._triggering.values():
            item.links = {linked_id: None for linked_id in item.links or () if linked_id in self._monitored_items}
        self._links = sum(len(item.links or ()) for item in self._triggering.values())

    def fired(self, item: Item) -> None:
        """An item with links has a notification."""
        self._fired[item.id] = item

    def triggered(self) -> Iterator[Item]:
        """The items that only sample and are to be reported, since others have fired after the last time."""
        if not self._fired:
            return
        fired, self._fired = self._fired, {}
        for item in fired.values():
            for linked_id in item.links or ():
                linked = self._monitored_items.get(linked_id)
                if linked is not None and linked.mode is ua.MonitoringMode.Sampling and linked.waits:
                    yield linked

    def watches(self, node_id: ua.NodeId) -> bool:
        """Whether an item is told of this node's events."""
        return node_id in self._by_node

    def are_behind(self, item_id: int | None = None) -> bool:
        """Whether an item that watches events, or this one, has to be rid of some before it is told more."""
        if item_id is not None:
            item = self._monitored_items.get(item_id)
            return isinstance(item, EventItem) and item.is_behind
        return any(item.is_behind for items in self._by_node.values() for item in items.values())

    def tell(self, event: Any) -> None:
        """Tell the items of the event's node."""
        for item in list(self._by_node.get(event.emitting_node, {}).values()):
            item.happened(event)

    async def trigger_event(self, event: Any, mid: int | None = None) -> bool:
        """Tell the items of the event's node; called by asyncua."""
        items = self._by_node.get(event.emitting_node)
        for item in list(items.values()) if items else []:
            if mid is None or item.id == mid:
                try:
                    item.happened(event)
                except Exception as error:  # noqa: BLE001 - costs this item the event, and the others nothing
                    self._failed(error)
        return bool(items)
