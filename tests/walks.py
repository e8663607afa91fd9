"""The way of one value through the functions of a process, by `sys.setprofile`.

A value passes from place to place: a queue, a socket, the answer to a client. A function of ours counts as *passed*
where it gets the value as an argument (as itself, in a record, or in the bytes of a datagram) and the value comes to
the next place before it returns: so what hands the value on counts, and neither what only looks at it nor what puts it
into another form for one that hands it on. A function counts once, however often it is called.

What puts it into another form is counted by itself, where it is named: each time that one of these functions gets the
value, or returns it, within a function that takes it from a place, before the last place is done with it. What only
hears the message too, as its sender does, is not on the way.
"""

from __future__ import annotations

import struct
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from inspect import CO_VARARGS
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, Final, Self

from ua_fleet.endpoint.answers import EncodedResponse

__all__ = ["Walk"]

_ROOT: Final = Path(__file__).parents[1]
_OURS: Final = tuple(f"{_ROOT / folder}/" for folder in ("ua_fleet", "bridges/ua_bridges"))
_DEPTH: Final = 6
"""Records within records that are looked into."""
_Stack = list[tuple[CodeType, bool]]


class Walk:
    """While it lasts, notes how a number comes from place to place."""

    def __init__(
        self, value: float, places: Iterable[str], counted: Iterable[str] = (), within: Iterable[str] = ()
    ) -> None:
        """Follow a number; `places` are the functions, by their qualified names, that put it where it waits or leaves,
        and `counted` those whose calls with it, or that give it, are counted `within` one of these.

        It has to be one that comes nowhere else.
        """
        self._value, self._bytes = value, struct.pack("<d", value)
        self._places, self._counted, self._within = frozenset(places), frozenset(counted), frozenset(within)
        self.calls = Counter[str]()
        """How often functions that are counted have got it, or returned it."""
        self._is_over = False
        self._stacks: dict[int, _Stack] = {}
        self.ways: dict[str, list[str]] = {}
        """The functions by which it came to each place, the first of which took it from the place before."""

    @property
    def functions(self) -> list[str]:
        """All functions that it has passed, in order."""
        return list(dict.fromkeys(name for way in self.ways.values() for name in way))

    def __enter__(self) -> Self:
        threading.setprofile(self._happened)
        sys.setprofile(self._happened)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
        threading.setprofile(None)

    def _happened(self, frame: FrameType, event: str, result: Any) -> None:
        code = frame.f_code
        if not code.co_filename.startswith(_OURS):
            return
        stack = self._stacks.setdefault(threading.get_ident(), [])
        if event == "call":
            has_rest = bool(code.co_flags & CO_VARARGS)
            names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount + has_rest]
            given = [frame.f_locals[name] for name in names if name != "self" and name in frame.f_locals]
            stack.append((code, any(self._has(each, _DEPTH) for each in given)))
            name = code.co_qualname
            if stack[-1][1] and name in self._counted:
                self._count(name, stack)
            if stack[-1][1] and name in self._places and name not in self.ways:
                self.ways[name] = [passed.co_qualname for passed, has_it in stack if has_it]
        elif event == "return" and stack and stack[-1][0] is code:  # else it was called before this began
            _, had_it = stack.pop()
            name = code.co_qualname
            if not had_it and name in self._counted and self._has(result, _DEPTH):
                self._count(name, stack)
            self._is_over |= self.ways.keys() == self._places and name == list(self.ways)[-1]

    def _count(self, name: str, stack: _Stack) -> None:
        if not self._is_over and any(code.co_qualname in self._within for code, _ in stack):
            self.calls[name] += 1

    def _has(self, found: Any, depth: int) -> bool:
        if isinstance(found, float):
            return found == self._value
        if isinstance(found, bytes):
            return self._bytes in found
        if not depth:
            return False
        inner: Iterable[Any]
        records: Any = found
        if isinstance(found, tuple | list):
            inner = records
        elif isinstance(found, Mapping):
            inner = records.values()
        elif isinstance(found, EncodedResponse):
            inner = (found.parameters,)
        elif is_dataclass(found) and not isinstance(found, type):
            inner = [getattr(found, each.name, None) for each in fields(found)]
        else:
            return False
        return any(self._has(each, depth - 1) for each in inner)
