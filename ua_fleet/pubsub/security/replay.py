"""Each nonce once: the replay windows of one security token (OPC 10000-14 7.2.3, 7.2.4.4.3.2).

A MessageNonce ends with a number that its sender increases with every message. A window remembers which numbers of one
sender were taken, in pages of 65,536: a bit for each number, and which pages are closed.

    its page is open       taken if it was not
    its page is not open   a page is opened, and the number taken; the page that was used least recently is put away
                           where `MOST_PAGES` are open: closed, or as its numbers where they are few
    its page is closed     refused

So a number is taken once for its key, whatever came between, and no single message keeps others out: neither one that
jumps ahead, as after a restart (`nonces.py` reserves a page at once), nor one that was lost for as long as a network
was away. Whoever has the key and writes in another's name has to use `MOST_PAGES` pages between two messages of that
other to close the page of its numbers, or spend `MOST_SINGLE` messages to close pages before that other comes to them.

Where a window begins depends on what may have happened before. Under a token that was a future one when we got it,
nothing: any number may come. Under one that was in use already, a receiver that was restarted cannot know what it has
taken in its former life: it takes the first number that it hears and none below.

A window is looked at only after a message was verified, so who has no key can neither fill nor move one.

Whose numbers? In the group of a publisher's data it is the only sender. In the group of a responder's Actions each
member counts for itself: windows are told apart by the first two bytes of the nonce, where our processes write their
space (`nonces.py`). These bytes are signed, so a message cannot be sent again with others. They do not prove who wrote
them: every member has the key and could write any. Who may command is decided by the RequestorId, later. A window is
never given up while its token lives, as what it remembers could be sent again; where there are too many, further
senders are refused.
"""

from __future__ import annotations

from typing import Final

__all__ = ["FEW", "MOST_PAGES", "MOST_WINDOWS", "PAGE", "ReplayWindow", "ReplayWindows"]

PAGE: Final = 65_536
"""Numbers of a page. The first page begins with 1, as the numbers of a sender do."""
MOST_PAGES: Final = 16
"""Open pages of one sender, of 8 KiB each."""
FEW: Final = 16
"""Numbers of a page that is put away without being closed."""
MOST_SINGLE: Final = 256
"""Numbers of all such pages of one sender."""
MOST_WINDOWS: Final = 64
"""Senders of one token."""

_MASK: Final = 0xFFFF_FFFF
_NUMBERS: Final = 1 << 32
_PAGE_BYTES: Final = PAGE // 8
_NO_PAGE: Final = -1


class ReplayWindow:
    """The numbers of one sender under one key."""

    __slots__ = ("_bits", "_closed", "_first", "_latest", "_pages", "_single", "_singles")

    def __init__(self, first: int = 0) -> None:
        """Take nothing yet, and nothing below `first` ever."""
        self._first = first
        self._pages: dict[int, bytearray] = {}
        """The open ones, the least recently used first."""
        self._single: dict[int, tuple[int, ...]] = {}
        """Places of the numbers in pages that were put away with few."""
        self._singles = 0
        self._closed: bytearray | None = None
        """A bit for each page; None while there is none."""
        self._latest = _NO_PAGE
        self._bits = bytearray()
        """The page that was used last."""

    def take(self, number: int) -> bool:
        """Take a number; False if it was taken before or is too old to know."""
        if number < self._first:
            return False
        place = (number - 1) & _MASK
        page = place // PAGE
        if page != self._latest and not self._turn_to(page):
            return False
        at, bit = place % PAGE >> 3, 1 << (place & 7)
        bits = self._bits
        if bits[at] & bit:
            return False
        bits[at] |= bit
        return True

    def has(self, number: int) -> bool:
        """Whether a number was taken, or may have been."""
        page, place = divmod((number - 1) & _MASK, PAGE)
        if (bits := self._pages.get(page)) is not None:
            return bool(bits[place >> 3] & 1 << (place & 7))
        closed = self._closed
        is_closed = closed is not None and bool(closed[page >> 3] & 1 << (page & 7))
        return is_closed or place in self._single.get(page, ())

    def _turn_to(self, page: int) -> bool:
        pages = self._pages
        bits = pages.pop(page, None)
        if bits is None:
            closed = self._closed
            if closed is not None and closed[page >> 3] & 1 << (page & 7):
                return False
            bits = bytearray(_PAGE_BYTES)
            known = self._single.pop(page, ())
            self._singles -= len(known)
            for place in known:
                bits[place >> 3] |= 1 << (place & 7)
            if len(pages) >= MOST_PAGES:
                self._put_away(next(iter(pages)))
        pages[page] = self._bits = bits
        self._latest = page
        return True

    def _put_away(self, page: int) -> None:
        bits = int.from_bytes(self._pages.pop(page), "little")
        count = bits.bit_count()
        if count <= FEW and self._singles + count <= MOST_SINGLE:
            places: list[int] = []
            while bits:
                places.append((bits & -bits).bit_length() - 1)
                bits &= bits - 1
            self._single[page] = tuple(places)
            self._singles += count
            return
        if self._closed is None:
            self._closed = bytearray(_NUMBERS // PAGE // 8)
        self._closed[page >> 3] |= 1 << (page & 7)


class ReplayWindows:
    """The windows of one token, one for each sender."""

    __slots__ = ("_is_unused", "_windows")

    def __init__(self, *, is_unused: bool) -> None:
        self._is_unused = is_unused
        self._windows: dict[int, ReplayWindow] = {}

    def has(self, sender: int, number: int) -> bool:
        """Whether a number of a sender was taken."""
        window = self._windows.get(sender)
        return window is not None and window.has(number)

    def take(self, sender: int, number: int) -> bool:
        """Take a number of a verified message; False if that must not be taken."""
        window = self._windows.get(sender)
        if window is None:
            if len(self._windows) >= MOST_WINDOWS:
                return False
            window = self._windows[sender] = ReplayWindow(0 if self._is_unused else number)
        return window.take(number)
