"""Names of nodes as people shorten them: `rover`, `rover.battery`, `rover.*.battery`, `**.battery`. Pure.

A pattern is held against the names of nodes on the way down from a start, one after the other, so that a subtree in
which nothing can match is never looked at. It is a small automaton: a state is a place in the pattern, and what is fed
are the characters of `/name`.
"""

from __future__ import annotations

from typing import Final

__all__ = ["Pattern", "has_wildcard"]

_STAR, _DEEP, _ANY, _DOT = "*", "**", "?", "."
_WILDCARDS: Final = frozenset("*?")


def has_wildcard(text: str) -> bool:
    """Whether a text stands for names that it does not spell out."""
    return not _WILDCARDS.isdisjoint(text)


class Pattern:
    """A pattern over the names on the way from a start to a node.

    `*` is any part of one name, `?` one character of it, and `**` any number of whole names. Names are separated by
    `/`, or, in a pattern without `/`, by `.`, which also stands for a dot that a name has.
    """

    __slots__ = ("_tokens", "ends_literally", "first", "has_depth", "start")

    def __init__(self, text: str) -> None:
        self._tokens = _tokens(text.strip("/"))
        separator = "/" if "/" in text else "."
        parts = text.strip("/").split(separator)
        self.first = parts[0]
        """The first name, with its wildcards."""
        self.ends_literally = not has_wildcard(parts[-1])
        """Whether it spells out the last name."""
        self.has_depth = _DEEP in text
        """Whether it may name nodes at any depth."""
        self.start = self._closed({0})
        """Where nothing has been fed yet."""

    def feed(self, states: frozenset[int], name: str) -> frozenset[int]:
        """The states one level deeper, at a node of that name; empty where nothing below it can match."""
        for char in f"/{name}":
            states = self._closed({after for state in states for after in self._step(state, char)})
            if not states:
                break
        return states

    def is_match(self, states: frozenset[int]) -> bool:
        """Whether the node at which these states are is one that the pattern names."""
        return len(self._tokens) in states

    def _step(self, state: int, char: str) -> tuple[int, ...]:
        if state == len(self._tokens):
            return ()
        token = self._tokens[state]
        if token == _STAR:
            return (state,) if char != "/" else ()
        if token == _DEEP:
            return (state,)
        if token == _ANY:
            return (state + 1,) if char != "/" else ()
        if token == _DOT:
            return (state + 1,) if char in "/." else ()
        return (state + 1,) if char == token[-1] else ()

    def _closed(self, states: set[int]) -> frozenset[int]:
        """With the states that need no character: `*` and `**` may be empty, and `**` no name at all."""
        found: set[int] = set()
        left = list(states)
        while left:
            state = left.pop()
            if state in found:
                continue
            found.add(state)
            if state == len(self._tokens):
                continue
            if self._tokens[state] in (_STAR, _DEEP):
                left.append(state + 1)
            is_before_deep = self._is_separator(state) and self._tokens[state + 1 : state + 2] == [_DEEP]
            if is_before_deep and (state + 2 == len(self._tokens) or self._is_separator(state + 2)):
                left.append(state + 2)
        return frozenset(found)

    def _is_separator(self, place: int) -> bool:
        return self._tokens[place] in ("/", _DOT)


def _tokens(text: str) -> list[str]:
    """The pattern in pieces; a literal `.`, `*` cannot be meant where it separates or is a wildcard."""
    is_dotted = "/" not in text
    tokens = ["/"]
    at = 0
    while at < len(text):
        if text.startswith(_DEEP, at):
            tokens.append(_DEEP)
            at += 2
            continue
        char = text[at]
        tokens.append(f"\\{char}" if char == "." and not is_dotted else char)
        at += 1
    return tokens
