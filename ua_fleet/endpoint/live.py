"""Variables whose value is computed when it is read, and who may read them."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.stack import GOOD, AttributeIds, Refusal
from ua_fleet.endpoint.users import User

__all__ = ["Guard", "LiveValue", "check_reader", "reader_refused"]

Guard = Callable[[User, bool], int]
"""StatusCode with which a user, on an encrypted channel or not, is refused a value; 0 for who may read it."""


class LiveValue(HeldValue):
    """A value that is computed when it is read. Who watches it is told of changes when `tell` is called."""

    __slots__ = ("_compute", "_told", "_variant_type", "guard")

    def __init__(self, compute: Callable[[], Any], variant_type: ua.VariantType, guard: Guard | None = None) -> None:
        """Hold a value.

        Args:
            compute: gives it, a list for an array.
            variant_type: its type.
            guard: who may read it; without it everybody.
        """
        self._compute, self._variant_type, self.guard = compute, variant_type, guard
        self._told: dict[int, Any] = {}
        """What each who watches was told, by handle."""
        super().__init__(None)

    @property
    def value(self) -> ua.DataValue:
        """A fresh DataValue."""
        content = self._compute()
        now: Any = datetime.now(UTC)
        variant = ua.Variant(content, self._variant_type, is_array=isinstance(content, list))
        return ua.DataValue(variant, GOOD, now, now)

    @value.setter
    def value(self, value: ua.DataValue | None) -> None:
        """Nothing is kept."""

    async def tell(self) -> None:
        """Tell who watches it of a change, as far as they may still read it."""
        told, self._told = self._told, {}
        if not self.is_watched:
            return
        value = self.value
        assert value.Value is not None
        content = value.Value.Value, value.StatusCode
        for handle, callback in list(self.datachange_callbacks.items()):
            item: Any = getattr(callback, "__self__", None)
            if self.guard is not None and self.guard(*_reader(item)):
                item.owner.remove(item.id)  # whose rights are gone can't have the value told anew either
                continue
            # Who has come since the last time has got the value of then, which may be any.
            if handle not in told or told[handle] != content:
                await callback(handle, value)
            self._told[handle] = content


def _reader(item: Any) -> tuple[User, bool]:
    """The user that a monitored item tells, the session's or the one who had it where none has; whether encrypted."""
    session, owner = item.owner.session, item.owner.owner
    if session is None or session.user is None:
        return owner, True
    return session.user, session.usage.security_mode == ua.MessageSecurityMode.SignAndEncrypt


def check_reader(space: AddressSpace, node_id: ua.NodeId, attribute: int, user: User, *, encrypted: bool) -> None:
    """Raise Refusal where a user may not read a value that others may."""
    if attribute == AttributeIds.Value and (code := reader_refused(space, node_id, user, encrypted=encrypted)):
        raise Refusal(code)


def reader_refused(space: AddressSpace, node_id: ua.NodeId, user: User, *, encrypted: bool) -> int:
    """StatusCode with which a user is refused a node's value; 0 for who may read it."""
    node = space.get(node_id)
    held = node.attributes.get(AttributeIds.Value) if node is not None else None
    guard = held.guard if isinstance(held, LiveValue) else None
    return 0 if guard is None else guard(user, encrypted)
