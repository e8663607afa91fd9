"""What waits until clients fetch it, and how many bytes of it a user, or an address without one, and all may have.

Each monitored item has a queue of its own. Beyond a user's budget the item of that user that has waited longest loses
its oldest notification, and says so with the Overflow bit (OPC 10000-4 7.39.1); beyond the budget of all, one of the
user with the most. An item that has nothing left tells what its node is when its turn comes, so that no client takes an
old value for the last one.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, Final, Protocol, cast
from weakref import WeakValueDictionary

__all__ = ["Account", "Queues", "content_bytes"]

_ELEMENT_BYTES: Final = 32
"""Of a number in a list."""
_OBJECT_BYTES: Final = 100
"""Of an object that is not a number."""


def content_bytes(content: Any) -> int:
    """About the memory that a value takes besides the objects that hold it; of lists of numbers by their length."""
    if isinstance(content, str | bytes):
        return len(content)
    if isinstance(content, list | tuple):
        elements = cast("Sequence[Any]", content)
        if elements and isinstance(elements[0], int | float):
            return _ELEMENT_BYTES * len(elements)
        return sum([_OBJECT_BYTES + content_bytes(element) for element in elements])
    inner = getattr(content, "Body", None) or getattr(content, "Value", None) or getattr(content, "Text", None)
    return 0 if inner is None or isinstance(inner, int | float) else _OBJECT_BYTES + content_bytes(inner)


class Queued(Protocol):
    """A monitored item whose queue holds something."""

    def give_way(self) -> bool:
        """Lose the oldest notification; whether any is left."""
        ...


class Account:
    """What waits for one user."""

    __slots__ = ("__weakref__", "_all", "held_bytes", "items")

    def __init__(self, queues: Queues) -> None:
        self._all = queues
        self.held_bytes = 0
        self.items: OrderedDict[Queued, None] = OrderedDict()
        """Those whose queues hold something, the one that has waited longest first.

        To find the first of a dict takes the longer, the more have left it.
        """

    def hold(self, item: Queued, size: int) -> None:
        """An item has queued so many bytes."""
        self.items[item] = None
        self.held_bytes += size
        everything = self._all
        everything.held_bytes += size
        if self.held_bytes > everything.bytes_per_user:
            while self.held_bytes > everything.bytes_per_user and self.items:
                self.lose_one()
        elif everything.held_bytes > everything.bytes_of_all:
            everything.make_room()

    def release(self, size: int) -> None:
        """So many bytes are in no queue any more."""
        self.held_bytes -= size
        self._all.held_bytes -= size

    def leave(self, item: Queued) -> None:
        """The queue of an item is empty."""
        self.items.pop(item, None)

    def lose_one(self) -> None:
        """Lose what has waited longest."""
        item, _ = self.items.popitem(last=False)
        self._all.lost += 1
        if item.give_way():
            self.items[item] = None  # the next one is another item's


class Queues:
    """What waits for all users."""

    def __init__(self, bytes_per_user: int, bytes_of_all: int) -> None:
        self.bytes_per_user, self.bytes_of_all = bytes_per_user, bytes_of_all
        self.held_bytes = 0
        self.lost = 0
        """Notifications that gave way to others; what one queue alone was too short for is not among them."""
        self._accounts: WeakValueDictionary[str, Account] = WeakValueDictionary()

    def account(self, holder: str) -> Account:
        """What waits for a user, or an address without one. It lasts as long as one who has asked for it."""
        account = self._accounts.get(holder)
        if account is None:
            account = self._accounts[holder] = Account(self)
        return account

    def make_room(self) -> None:
        """Have those give way for whom the most waits."""
        while self.held_bytes > self.bytes_of_all:
            greediest = max(self._accounts.values(), key=lambda account: account.held_bytes, default=None)
            if greediest is None or not greediest.items:
                return
            greediest.lose_one()
