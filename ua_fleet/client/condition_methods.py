# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""What people do with a condition: its Methods (OPC 10000-9 5.5 to 5.8)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from asyncua import ua

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["ConditionClient"]

_ACKNOWLEDGE: Final = ua.ObjectIds.AcknowledgeableConditionType_Acknowledge
_CONFIRM: Final = ua.ObjectIds.AcknowledgeableConditionType_Confirm
_ADD_COMMENT: Final = ua.ObjectIds.ConditionType_AddComment
_ENABLE: Final = ua.ObjectIds.ConditionType_Enable
_DISABLE: Final = ua.ObjectIds.ConditionType_Disable
_SUPPRESS: Final = ua.ObjectIds.AlarmConditionType_Suppress
_UNSUPPRESS: Final = ua.ObjectIds.AlarmConditionType_Unsuppress
_TIMED_SHELVE: Final = ua.ObjectIds.ShelvedStateMachineType_TimedShelve
_ONE_SHOT_SHELVE: Final = ua.ObjectIds.ShelvedStateMachineType_OneShotShelve
_UNSHELVE: Final = ua.ObjectIds.ShelvedStateMachineType_Unshelve


class ConditionClient:
    """Calls the Methods of conditions, each by its ConditionId; raises AccessRefused with the StatusCode and reason."""

    def __init__(self, client: FleetClient) -> None:
        self._client = client

    async def acknowledge(self, condition: str, event_id: bytes, comment: str = "") -> None:
        """Say that what an event tells was seen; without a comment the one before stays."""
        await self._of_event(condition, _ACKNOWLEDGE, event_id, comment)

    async def confirm(self, condition: str, event_id: bytes, comment: str = "") -> None:
        """Say that what was to be done about it is done."""
        await self._of_event(condition, _CONFIRM, event_id, comment)

    async def add_comment(self, condition: str, event_id: bytes, comment: str) -> None:
        """Say something of it."""
        await self._of_event(condition, _ADD_COMMENT, event_id, comment)

    async def shelve(self, condition: str, time_s: float | None) -> None:
        """Put an alarm aside for a time; None: until it is inactive."""
        shelving = f"{condition}.ShelvingState"
        if time_s is None:
            await self._call(shelving, _ONE_SHOT_SHELVE)
        else:
            await self._call(shelving, _TIMED_SHELVE, ua.Variant(time_s * 1000, ua.VariantType.Double))

    async def unshelve(self, condition: str) -> None:
        """Take it back."""
        await self._call(f"{condition}.ShelvingState", _UNSHELVE)

    async def suppress(self, condition: str, *, suppressed: bool) -> None:
        """Suppress an alarm until somebody says otherwise, or say so."""
        await self._call(condition, _SUPPRESS if suppressed else _UNSUPPRESS)

    async def enable(self, condition: str, *, enabled: bool) -> None:
        """Have the server look at it, or look at it no longer."""
        await self._call(condition, _ENABLE if enabled else _DISABLE)

    async def _of_event(self, condition: str, method: int, event_id: bytes, comment: str) -> None:
        # A null is no comment; an empty one would take away what was said before (OPC 10000-9 5.7.3).
        await self._call(
            condition,
            method,
            ua.Variant(event_id, ua.VariantType.ByteString),
            ua.Variant(ua.LocalizedText(comment or None), ua.VariantType.LocalizedText),
        )

    async def _call(self, owner: str, method: int, *arguments: ua.Variant) -> None:
        await self._client.call(owner, f"i={method}", *arguments)
