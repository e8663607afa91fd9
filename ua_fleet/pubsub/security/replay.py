"""Each nonce once: the replay windows of one security token (OPC 10000-14 7.2.3, 7.2.4.4.3.2).

A MessageNonce ends with a number that its sender increases with every message. A window follows the numbers of one
sender: the highest one heard, and which of the 1,024 up to it were taken. With ahead = (number - highest) mod 2^32

    1 .. 2^30                newer: taken, the window moves (2^32 - 1 + number - highest gives less than 2^30)
    0, 2^32 - 1023 ..        in the window: taken if it was not, since a network reorders
    what is between          too old, or invalid: refused

Why no number is ever taken twice, though numbers roll over: a window that has walked 3 * 2^30 numbers in all refuses
what is newer, because the first numbers it took would begin to look newer again. The key has to be replaced then; our
own senders stop before (`LAST_NUMBER`).

Where a window begins depends on what may have happened before. Under a token that was a future one when we got it,
nothing: the window begins below any number. Under one that was in use already, a receiver that was restarted cannot
know what it has taken in its former life: it takes the first number that it hears and nothing older.

A window is looked at only after a message was verified, so who has no key can neither fill nor move one.

Whose numbers? In the group of a publisher's data it is the only sender. In the group of a responder's Actions each
member counts for itself: windows are told apart by the first two bytes of the nonce, where our processes write their
space (`nonces.py`). These bytes are signed, so a message cannot be sent again with others. They do not prove who wrote
them: every member has the key and could write any. Who may command is decided by the RequestorId, later. A window is
never given up while its token lives, as what it remembers could be sent again; where there are too many, further
senders are refused.
"""

from __future__ import annotations

from array import array
from typing import Final

__all__ = ["LAST_NUMBER", "MOST_WINDOWS", "WINDOW", "ReplayWindow", "ReplayWindows"]

WINDOW: Final = 1024
"""Numbers below the highest one that may still come."""
NEWEST_STEP: Final = 1 << 30
LAST_NUMBER: Final = 3 << 30
"""How far a window walks under one key, and the last number that our own senders use."""
MOST_WINDOWS: Final = 64
"""Senders of one token."""

_MASK: Final = 0xFFFF_FFFF
_SLOT: Final = WINDOW - 1
_EMPTY: Final = array("I", [(slot + 1) & _SLOT for slot in range(WINDOW)]).tobytes()
"""In each slot a number that does not belong there."""


class ReplayWindow:
    """The numbers of one sender under one key."""

    __slots__ = ("_below", "_highest", "_taken", "_walked")

    def __init__(self, first: int, *, is_unused: bool) -> None:
        """Begin with a first number, which is taken. `is_unused`: no older one can have been taken before."""
        self._highest = first
        self._walked = 0
        self._below = WINDOW if is_unused else 0
        """How far below the first number one may be taken."""
        self._taken = array("I")
        self._taken.frombytes(_EMPTY)
        self._taken[first & _SLOT] = first

    def take(self, number: int) -> bool:
        """Take a number; False if it was taken before or is too old to know."""
        ahead = (number - self._highest) & _MASK
        if 0 < ahead <= NEWEST_STEP:
            if self._walked + ahead > LAST_NUMBER:
                return False
            self._walked += ahead
            self._highest = number
        else:
            behind = -ahead & _MASK
            if behind >= WINDOW or behind > self._walked + self._below or self._taken[number & _SLOT] == number:
                return False
        self._taken[number & _SLOT] = number
        return True


class ReplayWindows:
    """The windows of one token, one for each sender."""

    __slots__ = ("_is_unused", "_windows")

    def __init__(self, *, is_unused: bool) -> None:
        self._is_unused = is_unused
        self._windows: dict[int, ReplayWindow] = {}

    def take(self, sender: int, number: int) -> bool:
        """Take a number of a verified message; False if that must not be taken."""
        window = self._windows.get(sender)
        if window is not None:
            return window.take(number)
        if len(self._windows) >= MOST_WINDOWS:
            return False
        self._windows[sender] = ReplayWindow(number, is_unused=self._is_unused)
        return True
