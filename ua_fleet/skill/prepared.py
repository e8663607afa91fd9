"""Requests whose records the owner writes, with what they follow from, in place of the requestor's journal.

propose -> the owner writes the record -> add -> take (it is sent), or
leave -> the owner deletes the record -> left_out
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, TypeVar

__all__ = ["PreparedRequests"]

_Request = TypeVar("_Request")


class PreparedRequests(Generic[_Request]):
    """Those that were written down, and are not sent, by their execution ids."""

    def __init__(self) -> None:
        self._prepared: dict[bytes, _Request] = {}
        self._left: dict[bytes, None] = {}

    def __contains__(self, execution_id: object) -> bool:
        """Whether its record is written down."""
        return execution_id in self._prepared or execution_id in self._left

    def is_next(self, execution_id: bytes) -> bool:
        """Whether it can be taken."""
        return execution_id in self._prepared

    def add(self, execution_id: bytes, request: _Request) -> None:
        """Its record is written down."""
        self._prepared[execution_id] = request

    def take(self, execution_id: bytes) -> _Request:
        """It is sent; KeyError where it is not there, or was left."""
        return self._prepared.pop(execution_id)

    def leave(self, execution_id: bytes) -> None:
        """It is not sent; where it is not there, nothing happens."""
        if self._prepared.pop(execution_id, None) is not None:
            self._left[execution_id] = None

    @property
    def left(self) -> tuple[bytes, ...]:
        """Those that were left, and whose records are to be deleted."""
        return tuple(self._left)

    def left_out(self, execution_ids: Iterable[bytes]) -> None:
        """Their records are deleted."""
        for execution_id in execution_ids:
            self._prepared.pop(execution_id, None)
            self._left.pop(execution_id, None)
