"""What people do with alarms: find them, acknowledge, confirm, comment, shelve, suppress, disable."""

from __future__ import annotations

from typing import Any, Final

from pydantic import Field

from ua_fleet.client import ConditionClient, FleetClient
from ua_fleet.console.operations.kinds import OperationKind, OperationParameters
from ua_fleet.console.shown import harmless_value

__all__ = ["ALARM_OPERATIONS"]

_WEEK_S: Final = 7 * 24 * 3600.0
"""MaxTimeShelved of the server."""


class Sought(OperationParameters):
    """Words that the name has, in any case, and how many alarms are told at most."""

    text: str = Field(default="", max_length=256)
    most: int = Field(default=1000, ge=1, le=2000)


class OfAlarm(OperationParameters):
    """An alarm by its ConditionId, e.g. `ns=2;s=Alarms.rover.speed`."""

    alarm: str = Field(pattern="^(ns=[0-9]{1,4};)?s=.", max_length=4096)


class OfEvent(OfAlarm):
    """What was seen of it, by the EventId in hexadecimal, and what somebody says of it."""

    event: str = Field(pattern="^([0-9a-f]{2}){1,64}$")
    comment: str = Field(default="", max_length=500)


class Shelved(OfAlarm):
    """For how long; null: until it is inactive."""

    time_s: float | None = Field(gt=0, le=_WEEK_S)


async def _list(client: FleetClient, asked: Sought) -> dict[str, Any]:
    words = asked.text.lower().split()
    found = [one for one in await client.declared_alarms() if all(word in one.name.lower() for word in words)]
    alarms = [
        {"id": harmless_value(one.name), "node": one.node_id, "kind": one.kind, "put_aside": one.is_put_aside}
        for one in found[: asked.most]
    ]
    return {"alarms": alarms, "all": len(found)}


async def _acknowledge(client: FleetClient, asked: OfEvent) -> None:
    await ConditionClient(client).acknowledge(asked.alarm, bytes.fromhex(asked.event), asked.comment)


async def _confirm(client: FleetClient, asked: OfEvent) -> None:
    await ConditionClient(client).confirm(asked.alarm, bytes.fromhex(asked.event), asked.comment)


async def _comment(client: FleetClient, asked: OfEvent) -> None:
    await ConditionClient(client).add_comment(asked.alarm, bytes.fromhex(asked.event), asked.comment)


async def _shelve(client: FleetClient, asked: Shelved) -> None:
    await ConditionClient(client).shelve(asked.alarm, asked.time_s)


async def _unshelve(client: FleetClient, asked: OfAlarm) -> None:
    await ConditionClient(client).unshelve(asked.alarm)


async def _suppress(client: FleetClient, asked: OfAlarm) -> None:
    await ConditionClient(client).suppress(asked.alarm, suppressed=True)


async def _unsuppress(client: FleetClient, asked: OfAlarm) -> None:
    await ConditionClient(client).suppress(asked.alarm, suppressed=False)


async def _enable(client: FleetClient, asked: OfAlarm) -> None:
    await ConditionClient(client).enable(asked.alarm, enabled=True)


async def _disable(client: FleetClient, asked: OfAlarm) -> None:
    await ConditionClient(client).enable(asked.alarm, enabled=False)


ALARM_OPERATIONS: Final = (
    OperationKind("alarm.list", Sought, _list, "Browse of Fleet.Alarms, Read of PutAside", "observer"),
    OperationKind("alarm.acknowledge", OfEvent, _acknowledge, "Acknowledge of an alarm", "operator"),
    OperationKind("alarm.confirm", OfEvent, _confirm, "Confirm of an alarm", "operator"),
    OperationKind("alarm.comment", OfEvent, _comment, "AddComment of an alarm", "operator"),
    OperationKind("alarm.shelve", Shelved, _shelve, "TimedShelve of an alarm", "operator"),
    OperationKind("alarm.unshelve", OfAlarm, _unshelve, "Unshelve of an alarm", "operator"),
    OperationKind("alarm.suppress", OfAlarm, _suppress, "Suppress of an alarm", "engineer"),
    OperationKind("alarm.unsuppress", OfAlarm, _unsuppress, "Unsuppress of an alarm", "engineer"),
    OperationKind("alarm.enable", OfAlarm, _enable, "Enable of an alarm", "engineer"),
    OperationKind("alarm.disable", OfAlarm, _disable, "Disable of an alarm", "engineer"),
)
