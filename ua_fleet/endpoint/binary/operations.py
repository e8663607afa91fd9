"""The operations of a request, which its parameters end in: where they begin, and each of them read once."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final, TypeVar

from asyncua.common.utils import Buffer

from ua_fleet.endpoint.decoding import decode_operation, operations_of, share_of
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.scan import Scan, step_of
from ua_fleet.endpoint.turns import Turns

__all__ = ["COUNT", "OperationReader", "Plain"]

COUNT: Final = struct.Struct("<i")
"""Number of operations, where nothing stands before it."""

T = TypeVar("T")
Plain = Callable[[bytes, int], tuple[T, int, int] | None]
"""A decoder of `decoders`: a value, where it ends, and the memory that it is charged; None for what is not plain."""


class OperationReader:
    """Reads the operations of one service's requests, with the budget of a request."""

    def __init__(self, kind: Any, limits: EndpointLimits, head: struct.Struct = COUNT, *, around: int = 0) -> None:
        """Read operations of a class.

        Args:
            kind: asyncua's class of an operation.
            limits: of the endpoint.
            head: the parameters before them; the last one is their number.
            around: bytes of memory that these take.
        """
        self._kind, self._limits, self._head, self._around = kind, limits, head, around
        self.step = step_of(kind)
        self._share = share_of(limits.request_memory_bytes)

    def begin(self, data: bytes, start: int, *, beside: int = 0) -> tuple[Scan, tuple[Any, ...]] | None:
        """A scan that stands where the operations begin, and the parameters before them with their number.

        None for a request that is refused as a whole, which is left to those who know why.

        Args:
            data: the whole request.
            start: where its parameters begin, or those that have a fixed size.
            beside: bytes of memory that are taken already.
        """
        head, around = self._head, self._around + beside
        if len(data) - start < head.size or beside > self._share:
            return None
        values = head.unpack_from(data, start)
        scan = operations_of(data, start + head.size, values[-1], self.step, self._limits, around=around)
        if scan is None:
            return None
        scan.charge(around)
        return scan, values

    async def all(self, scan: Scan, count: int, turns: Turns, one: Callable[[Scan], T]) -> list[T]:
        """Each operation as `one` reads it: all of them before the first one is done.

        Raises:
            Refusal: an operation is no valid encoding, or the request is not to go on.
        """
        read: list[T] = []
        for _ in range(count):
            scan.share = self._share
            scan.charge_built(self.step.memory)
            read.append(one(scan))
            if turns.over:
                await turns.end()
        return read

    def rest(self, scan: Scan, at: int, decode: Plain[T]) -> T | None:
        """What follows the known beginning of an operation; None where it is not plain, and nothing is read then.

        Args:
            scan: at the operation.
            at: where its beginning ends.
            decode: of what follows.
        """
        plain = decode(scan.data, at)
        if plain is None:
            return None
        value, scan.position, memory = plain
        scan.charge_built(memory)
        return value

    def whole(self, scan: Scan) -> Any:
        """An operation, by whatever way it can be decoded; raises Refusal for no valid encoding."""
        return decode_operation(self._kind, self.step.walk, scan, Buffer(scan.data, scan.position))
