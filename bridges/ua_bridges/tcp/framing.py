"""Fields on a socket to a program that can do little more than read bytes and compare them. Pure.

TCP merges and splits what is written, so the end of a field has to be in the bytes themselves. No pause between two
fields tells them apart (TalkRoBots waits 10 ms); see `Framing` in `config.py` for the three ways.
"""

from __future__ import annotations

from collections.abc import Sequence

from ua_bridges.tcp.config import Framing, InterpreterLink
from ua_fleet.errors import SkillRejected

__all__ = ["FieldReader", "FieldWriter", "FramingBroken"]


class FramingBroken(Exception):
    """The robot sent what is no field; the text says what. Where the next one would begin, nobody knows."""


class FieldWriter:
    """Makes bytes of fields."""

    def __init__(self, link: InterpreterLink) -> None:
        self._link = link
        self._terminator = link.terminator if link.framing is Framing.TERMINATOR else ""
        self._padded = link.length if link.framing is Framing.LENGTH else 0

    def encode(self, field: str) -> bytes:
        """The bytes of one field.

        Raises:
            SkillRejected: it is too long, cannot be encoded, or holds what would end it.
        """
        link = self._link
        if not field.isprintable() and field:
            raise SkillRejected(f"{field[:40]!r} has control characters, which a field cannot have")
        if self._terminator and self._terminator in field:
            raise SkillRejected(f"{field[:40]!r} holds {self._terminator!r}, which ends a field; choose another one")
        try:
            data = field.encode(link.encoding)
        except UnicodeEncodeError:
            raise SkillRejected(f"{field[:40]!r} cannot be written in {link.encoding}") from None
        longest = self._padded or link.longest_field
        if len(data) > longest:
            raise SkillRejected(f"{field[:40]!r} has {len(data)} bytes, and the robot takes {longest} in a field")
        if link.framing is Framing.ACKNOWLEDGED and not data:
            return b" "  # nothing can be acknowledged that is not sent
        return data.ljust(self._padded) if self._padded else data + self._terminator.encode("ascii")

    def encode_all(self, fields: Sequence[str]) -> tuple[bytes, ...]:
        """The bytes of the fields of one message; raises as `encode`, which is slower."""
        text = "".join(fields)
        is_plain = text.isascii() and text.isprintable() and (not self._terminator or self._terminator not in text)
        if not is_plain or self._padded or "" in fields or len(max(fields, key=len)) > self._link.longest_field:
            return tuple([self.encode(field) for field in fields])
        return tuple([(field + self._terminator).encode("ascii") for field in fields])


class FieldReader:
    """Takes the fields out of what arrives."""

    def __init__(self, link: InterpreterLink) -> None:
        self._link = link
        self._length = link.length if link.framing is Framing.LENGTH else 0
        self._terminator = link.terminator.encode("ascii")
        self._left = bytearray()

    @property
    def is_within(self) -> bool:
        """Whether a field was begun and has not ended."""
        return bool(self._left)

    def feed(self, data: bytes) -> list[str]:
        """The fields that are complete now.

        Raises:
            FramingBroken: a field is too long, or not in the configured encoding.
        """
        self._left += data
        if self._length:
            whole = len(self._left) // self._length * self._length
            raw = [bytes(self._left[at : at + self._length]) for at in range(0, whole, self._length)]
            del self._left[:whole]
            return [self._text(field).rstrip(" ") for field in raw]
        *raw_fields, rest = bytes(self._left).split(self._terminator)
        self._left = bytearray(rest)
        longest = self._link.longest_field
        for field in (*raw_fields, rest):
            if len(field) > longest:
                raise FramingBroken(f"a field of more than {longest} bytes; see longest_field and terminator")
        return [self._text(field).strip(" \r") for field in raw_fields]

    def _text(self, field: bytes) -> str:
        try:
            text = field.decode(self._link.encoding)
        except UnicodeDecodeError:
            raise FramingBroken(f"a field that is not {self._link.encoding}: {field[:40]!r}") from None
        if not text.strip("\r").isprintable() and text.strip("\r"):
            raise FramingBroken(f"a field with control characters: {field[:40]!r}")
        return text
