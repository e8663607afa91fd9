"""What the first bytes of an operation name, known by these bytes for as long as no node goes."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

from typing import Any, Final, Generic, TypeVar

from asyncua.server.address_space import AddressSpace, AttributeValue

from ua_fleet.endpoint.compact_nodes import HeldValue, Shared
from ua_fleet.endpoint.stack import AttributeIds

__all__ = ["LONGEST_KEY", "NODE_ID_BYTES", "Access", "Targets", "node_id_bytes", "plain_holders"]

LONGEST_KEY: Final = 256
"""Bytes of an operation that is remembered."""
_MOST_TARGETS: Final = 65_536
_STRING: Final = 3
"""Encoding byte of a NodeId with a String."""
NODE_ID_BYTES: Final = {0: 2, 1: 4, 2: 7, 4: 19}
"""Of NodeIds by their encoding byte (OPC 10000-6 5.2.2.9)."""
_PLAIN: Final = (HeldValue, Shared, AttributeValue)
"""Of others, the value is computed when it is read, and not for everybody."""
_ACCESS: Final = (AttributeIds.AccessLevel, AttributeIds.UserAccessLevel)

T = TypeVar("T")


class Access:
    """What AccessLevel and UserAccessLevel of a node were when it was looked at."""

    __slots__ = ("level", "level_value", "user_level", "user_level_value")

    def __init__(self, level: Any, user_level: Any) -> None:
        self.level, self.level_value = level, level.value
        self.user_level, self.user_level_value = user_level, user_level.value

    @property
    def is_as_it_was(self) -> bool:
        """Whether they are the same objects still, which nobody changes."""
        return self.level.value is self.level_value and self.user_level.value is self.user_level_value


class Targets(Generic[T]):
    """Targets by the bytes that name them."""

    def __init__(self, aspace: AddressSpace) -> None:
        self._aspace: Any = aspace
        self._known: dict[bytes, T] = {}
        self._removed = -1

    @property
    def removed(self) -> int:
        """How many nodes have gone; who has looked at targets before looks again when it is another number."""
        number: int = self._aspace._nodes.removed  # noqa: SLF001 - it has no accessor
        return number

    def known(self) -> dict[bytes, T]:
        """The targets, none of which belongs to a node that has gone."""
        removed = self.removed
        if removed != self._removed or len(self._known) >= _MOST_TARGETS:
            self._known.clear()
            self._removed = removed
        return self._known


def plain_holders(node: Any, attribute: Any) -> list[Any] | None:
    """What holds an attribute, and for a value both access levels; None where one of them is not just held."""
    wanted = (attribute, *_ACCESS) if attribute == AttributeIds.Value else (attribute,)
    holders: list[Any] = [node.attributes.get(each) for each in wanted]
    return None if any(type(each) not in _PLAIN or each.value_callback is not None for each in holders) else holders


def node_id_bytes(data: bytes, position: int) -> int:
    """Bytes of a NodeId that begins there; of one with bytes, or with no valid encoding, whatever comes out."""
    kind = data[position] if position < len(data) else 0
    if kind == _STRING:
        return 7 + int.from_bytes(data[position + 3 : position + 7], "little")
    return NODE_ID_BYTES.get(kind, 0)
