"""What `ua-fleet pubsub listen` hears, as lines."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Sequence
from typing import Any, Final, cast

from ua_fleet.cli.output import print_json, print_line
from ua_fleet.counters import Counters
from ua_fleet.pubsub.events import (
    DataReceived,
    MetaDataReceived,
    SourceReturned,
    SourceSilent,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Side, Verdict
from ua_fleet.transport.base import Address, Transport
from ua_fleet.values import BuiltinType, Variant, datetime_from_ticks, status_name
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["Listener", "figures_text"]

_NOBODY: Final = -1
"""A listener stands in no space, so that nothing is its own."""


def _hear_all(_side: Side, _origin: int, _own_space: int, _own_publication: bool) -> Verdict:
    return Verdict.TO_SPACE


def _plain(value: Any, field: FieldMetaData) -> Any:
    """A field's value as JSON can hold it: times as ISO 8601, bytes as hexadecimal, NaN and Bad fields as text."""
    if isinstance(value, Variant):
        return status_name(value.value) if value.type == BuiltinType.STATUS_CODE else _plain(value.value, field)
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return datetime_from_ticks(value).isoformat() if field.builtin_type == BuiltinType.DATETIME else int(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, bytes):
        return value.hex()
    if type(value) is tuple:
        return [_plain(element, field) for element in cast("Sequence[Any]", value)]
    return str(value)


class Listener:
    """Prints what a subscriber hears, until it has printed as many lines as are wanted."""

    def __init__(self, timing: PubSubTiming, *, count: int | None, as_json: bool) -> None:
        self.counters = Counters()
        self.lines = 0
        self._subscriber = Subscriber(_NOBODY, timing, self.counters, Codec(), _hear_all)
        self._left, self._as_json = count, as_json
        self._changed = asyncio.Event()
        self._transport: Transport | None = None

    async def listen(self, transport: Transport) -> None:
        """Listen until enough lines are printed, or cancelled; then the transport is closed."""
        self._transport = transport
        loop = asyncio.get_running_loop()
        try:
            await transport.start(self._receive)
            while self._left != 0:
                self._changed.clear()
                deadline = self._subscriber.next_deadline()
                try:
                    async with asyncio.timeout_at(deadline):
                        await self._changed.wait()
                except TimeoutError:
                    self._show(self._subscriber.poll(loop.time()))
        finally:
            await transport.close()

    def _receive(self, datagram: bytes, _sender: Address) -> None:
        self._show(self._subscriber.receive(datagram, asyncio.get_running_loop().time()))
        self._changed.set()

    def _show(self, events: list[SubscriberEvent]) -> None:
        for event in events:
            if isinstance(event, SourceUnknown):
                if event.datagram and self._transport is not None:
                    self._transport.send(event.datagram)
                continue
            if self._left == 0:
                return
            shown = _described(event)
            if shown is None:
                continue
            print_json(shown) if self._as_json else print_line(_as_text(shown))
            self.lines += 1
            if self._left is not None:
                self._left -= 1

    def figures(self) -> dict[str, Any]:
        """What was received and what was dropped, by cause."""
        counters = self.counters
        return {
            "messages": counters.messages_in,
            "gaps": counters.gaps,
            "drops": dict(counters.drops),
            "malformed": dict(counters.malformed),
        }


def _described(event: SubscriberEvent) -> dict[str, Any] | None:
    """One line of output as data; None for what listeners do not care about."""
    if isinstance(event, DataReceived):
        frame, metadata = event.message, event.metadata
        values = zip(metadata.fields, frame.values, strict=True)
        return {
            "event": "data",
            "topic": event.topic.name,
            "name": metadata.name,
            "time": None if frame.timestamp is None else datetime_from_ticks(frame.timestamp).isoformat(),
            "status": status_name(frame.status or 0),
            "fields": {field.name: _plain(value, field) for field, value in values},
        }
    if isinstance(event, MetaDataReceived):
        fields = {
            field.name: BuiltinType(field.builtin_type).name.lower() + ("[]" if field.value_rank > 0 else "")
            for field in event.metadata.fields
        }
        return {"event": "metadata", "topic": event.topic.name, "name": event.metadata.name, "fields": fields}
    if isinstance(event, SourceSilent):
        return {"event": "silent", "topic": event.topic.name}
    if isinstance(event, SourceReturned):
        return {"event": "returned", "topic": event.topic.name}
    return None


def _as_text(shown: dict[str, Any]) -> str:
    parts: list[str] = [] if shown["event"] == "data" else [shown["event"]]
    parts.append(shown["topic"])
    if shown.get("name", shown["topic"]) != shown["topic"]:
        parts.append(f"({shown['name']})")
    for name, value in shown.get("fields", {}).items():
        text = value if shown["event"] == "metadata" else json.dumps(value, ensure_ascii=False)
        parts.append(f"{name}={text}")
    if shown.get("status", "Good") != "Good":
        parts.append(shown["status"])
    if shown.get("time"):
        parts.append(shown["time"])
    return "  ".join(parts)


def figures_text(figures: dict[str, Any]) -> str:
    """The figures of a listener for people."""
    drops = {**figures["drops"], "kernel": figures["kernel_drops"]}
    dropped = ", ".join(f"{cause} {count}" for cause, count in sorted(drops.items()) if count) or "nothing"
    causes = ", ".join(f"{cause} {count}" for cause, count in sorted(figures["malformed"].items()))
    malformed = f" (malformed: {causes})" if causes else ""
    return f"messages: {figures['messages']}, gaps: {figures['gaps']}, dropped: {dropped}{malformed}"
