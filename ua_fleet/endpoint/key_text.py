"""What a session key looks like: `uafk.<id>.<secret>`, so that it is no password, and scanners for secrets find it."""

from __future__ import annotations

import re
import secrets
from typing import Final, NamedTuple

__all__ = ["KeyText", "looks_like_key", "new_key", "parse_key"]

SECRET_BYTES: Final = 32
_KEY: Final = re.compile(r"uafk\.([0-9a-f]{16})\.([A-Za-z0-9_-]{43})")


class KeyText(NamedTuple):
    """The parts of a key."""

    id: str
    """Names the key in lists and logs; no secret."""
    secret: str

    def __str__(self) -> str:
        return f"uafk.{self.id}.{self.secret}"


def new_key() -> KeyText:
    """A key that nobody has."""
    return KeyText(secrets.token_hex(8), secrets.token_urlsafe(SECRET_BYTES))


def parse_key(text: str) -> KeyText | None:
    """The parts of a key; None for a text that is none."""
    found = _KEY.fullmatch(text)
    return KeyText(found[1], found[2]) if found else None


def looks_like_key(text: str) -> bool:
    """Whether a text is a key, and so no password."""
    return parse_key(text) is not None
