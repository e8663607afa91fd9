"""What waits for one browser: merged by key, so that the latest wins, and never more than one message under way.

A browser that is behind costs the console no memory: only keys wait here, and a message is made of what the boards hold
at the moment at which it goes. Time is an argument, in seconds of a clock that never goes back.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from typing import Any, Final

from ua_fleet.console.board import Board, encoded

__all__ = ["FEW_CHARACTERS", "LEAST_INTERVAL_S", "MOST_CHARACTERS", "MOST_INTERVAL_S", "PageOutbox"]

LEAST_INTERVAL_S: Final = 0.05
MOST_INTERVAL_S: Final = 5.0
"""A browser that confirms is told something at least so often: silence for longer tells it that the link is gone."""
MOST_CHARACTERS: Final = 16_384
"""Of a feed in a message, about, unless it is told whole: a page that had all robots at once would stand still for it.
300 of them have room if only their times changed. What waits for longest goes first, the rest with the next message."""
FEW_CHARACTERS: Final = 6_000
"""With so many of a feed a message may end, where what waits is told in about ten such: 1,000 robots that all tell
something each second then take half a second of small updates. More that wait have larger ones, up to the above."""
_MESSAGES: Final = 10
_SLACK: Final = 1000


class _Watched:
    """A feed that the browser wants: what of it waits."""

    def __init__(self, board: Board, waits: Callable[[], None], most_characters: int) -> None:
        self.board, self._waits, self._most_characters = board, waits, most_characters
        self.whole = board.is_ready
        self.keys: dict[str, str | None] = {}
        """Those that wait: what has changed of one that the browser has as it was before, or None: it is told whole."""
        self.has_failed = True
        """Whether its error, or that it has none, is still to be told: a page that comes back may show an older one."""
        board.attach(self)

    @property
    def is_waiting(self) -> bool:
        return self.whole or bool(self.keys) or self.has_failed

    def changed(self, key: str, part: str | None) -> None:
        if self.whole:
            return
        self.keys[key] = None if key in self.keys else part
        if len(self.keys) > 2 * len(self.board) + _SLACK:  # keys that came and went
            self.replaced()
        self._waits()

    def replaced(self) -> None:
        self.whole = True
        self.keys.clear()
        self._waits()

    def failed(self) -> None:
        self.has_failed = True
        self._waits()

    def taken(self) -> str:
        """What waits, or a part of it, as JSON; that does not wait any more."""
        parts: list[str] = []
        board = self.board
        if not board.is_ready:
            self.keys.clear()  # it will be told whole
        elif self.whole:
            self.whole = False
            self.keys.clear()
            parts += ['"whole":true', f'"set":{{{",".join(_pair(key, text) for key, text in board.items())}}}']
        elif self.keys:
            parts += self._longest_waiting()
        if self.has_failed:
            self.has_failed = False
            parts.append(f'"error":{board.error or "null"}')
        return f"{{{','.join(parts)}}}"

    def _longest_waiting(self) -> list[str]:
        """As many of the keys as a message may have, with what is told of them."""
        set_, part, gone = list[str](), list[str](), list[str]()
        characters, enough = 0, len(self.keys) / _MESSAGES
        for told, (key, changed) in enumerate(self.keys.items(), 1):
            text = changed or self.board.get(key)
            if text is None:
                gone.append(json.dumps(key, ensure_ascii=False))
            else:
                (set_ if changed is None else part).append(_pair(key, text))
            characters += len(key) + len(text or "")
            if characters >= self._most_characters or (characters >= FEW_CHARACTERS and told >= enough):
                break
        told = len(set_) + len(part) + len(gone)
        for key in list(itertools.islice(self.keys, told)):
            del self.keys[key]
        told_by = (("set", "{", set_, "}"), ("part", "{", part, "}"), ("gone", "[", gone, "]"))
        return [f'"{name}":{opens}{",".join(all_)}{closes}' for name, opens, all_, closes in told_by if all_]


def _pair(key: str, text: str) -> str:
    return f"{json.dumps(key, ensure_ascii=False)}:{text}"


class PageOutbox:
    """What waits for one browser. `waits` is called when there is something to send, perhaps again."""

    def __init__(self, waits: Callable[[], None] = lambda: None, most_characters: int = MOST_CHARACTERS) -> None:
        self._waits, self._most_characters = waits, most_characters
        self._feeds: dict[str, _Watched] = {}
        self._refused: dict[str, str] = {}
        self._links: dict[str, str] = {}
        self._number = 0
        self._unseen = 0
        self._sent_at = float("-inf")

    def __len__(self) -> int:
        return len(self._feeds)

    @property
    def is_unconfirmed(self) -> bool:
        """Whether a message is under way."""
        return self._unseen > 0

    @property
    def waiting_keys(self) -> int:
        """How many keys wait."""
        return sum(len(one.keys) for one in self._feeds.values())

    @property
    def waiting_refusals(self) -> int:
        """How many feeds are still to be told as refused."""
        return len(self._refused)

    def want(self, name: str, board: Board) -> None:
        """Send a feed from now on, whole at first; one of this name that there was is over."""
        self.drop(name)
        self._refused.pop(name, None)
        self._feeds[name] = _Watched(board, self._waits, self._most_characters)
        if self._feeds[name].is_waiting:
            self._waits()

    def drop(self, name: str) -> None:
        """Send a feed no more."""
        watched = self._feeds.pop(name, None)
        if watched is not None:
            watched.board.detach(watched)

    def refuse(self, name: str, error: Any) -> None:
        """Say why there is no such feed."""
        self.drop(name)
        self._refused[name] = encoded(error)
        self._waits()

    def link(self, fleet: str, state: Any) -> None:
        """Say how the link to a fleet is."""
        self._links[fleet] = encoded(state)
        self._waits()

    def seen(self, number: int) -> bool:
        """The browser has taken a message; False where no such message is under way."""
        if number != self._unseen or not number:
            return False
        self._unseen = 0
        self._waits()
        return True

    def due_s(self, now: float) -> float | None:
        """In how many seconds the next message goes; None: one is under way."""
        if self._unseen:
            return None
        interval_s = LEAST_INTERVAL_S if self._is_waiting() else MOST_INTERVAL_S
        return max(0.0, self._sent_at + interval_s - now)

    def next(self, now: float, time: str = "") -> str | None:
        """The next message, where one is due; `time` is what clocks show, by which the page tells ages."""
        if self.due_s(now) != 0.0:
            return None
        self._number += 1
        self._unseen, self._sent_at = self._number, now
        feeds = [_pair(name, watched.taken()) for name, watched in self._feeds.items() if watched.is_waiting]
        feeds += [_pair(name, f'{{"error":{error}}}') for name, error in self._refused.items()]
        links = [_pair(name, state) for name, state in self._links.items()]
        self._refused, self._links = {}, {}
        tail = f',"links":{{{",".join(links)}}}' if links else ""
        tail += f',"now":{json.dumps(time)}' if time else ""
        return f'{{"n":{self._number},"feeds":{{{",".join(feeds)}}}{tail}}}'

    def close(self) -> None:
        """The browser is gone."""
        for name in list(self._feeds):
            self.drop(name)

    def _is_waiting(self) -> bool:
        return bool(self._links or self._refused) or any(one.is_waiting for one in self._feeds.values())
