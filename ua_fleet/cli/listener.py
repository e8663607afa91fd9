"""What `ua-fleet pubsub listen` hears, as lines."""

from __future__ import annotations

import asyncio
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final, cast

from ua_fleet.cli.discovery_json import announcement_as_json
from ua_fleet.cli.message_json import KINDS, MODES, action_as_json
from ua_fleet.cli.opening import REFRESH_S, OpenedDatagram, Opener, ToolKeys
from ua_fleet.cli.output import print_json, print_line
from ua_fleet.counters import Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.events import (
    DataReceived,
    EventReceived,
    MetaDataReceived,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.teleoperation.messages import read_setpoint
from ua_fleet.topics import LoopVerdict, Side
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.party import Brokered, tool_party
from ua_fleet.values import BuiltinType, Variant, datetime_from_ticks, status_name
from ua_fleet.wire import ActionMessage, Codec
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData, FrameKind, MetaDataAnnouncement, NetworkMessage, Probe
from ua_fleet.wire.security import NONCE_BYTES, SecurityMode

__all__ = ["MessagePrinter", "figures_text"]

_NOBODY: Final = -1
"""A listener stands in no space, so that nothing is its own."""


def _hear_all(_side: Side, _origin: int, _own_space: int, _own_publication: bool) -> LoopVerdict:
    return LoopVerdict.TO_SPACE


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


class MessagePrinter:
    """Prints what is heard, until it has printed as many lines as are wanted."""

    def __init__(
        self,
        timing: PubSubTiming,
        opener: Opener,
        *,
        count: int | None,
        as_json: bool,
        setpoint_groups: Mapping[int, int] | None = None,
    ) -> None:
        """Prepare; `setpoint_groups` as in Subscriber."""
        self.counters = opener.counters
        self.lines = 0
        self.kinds: Counter[str] = Counter()
        """What was opened, by its kind."""
        self._opener = opener
        self._codec = Codec()
        self._setpoint_groups = setpoint_groups or {}
        self._subscriber = Subscriber(
            _NOBODY, timing, opener.counters, self._codec, _hear_all, setpoint_groups=setpoint_groups
        )
        self._left, self._as_json = count, as_json
        self._changed = asyncio.Event()
        self._transport: Transport | None = None

    async def listen(self, transport: Transport, keys: ToolKeys | None = None) -> None:
        """Listen until enough lines are printed, or cancelled; then the transport is closed."""
        self._transport = transport
        if isinstance(transport, Brokered):
            transport.speak_for(tool_party(partial(self._receive, is_fresh=False)))
        loop = asyncio.get_running_loop()
        try:
            await transport.start(self._receive)
            while self._left != 0:
                self._changed.clear()
                deadline = self._subscriber.next_deadline()
                if keys is not None:
                    await keys.refresh()
                    soon = loop.time() + REFRESH_S
                    deadline = soon if deadline is None else min(deadline, soon)
                try:
                    async with asyncio.timeout_at(deadline):
                        await self._changed.wait()
                except TimeoutError:
                    self._show(self._subscriber.poll(loop.time()), None)
        finally:
            await transport.close()

    def _receive(self, datagram: bytes, _sender: Address, *, is_fresh: bool = True) -> None:
        now = asyncio.get_running_loop().time()
        opened = self._opener.open(datagram, now, is_fresh=is_fresh)
        if opened.plain is not None:
            shown = self._count(opened.plain)
            if shown is not None:
                self._print({**shown, **security_as_json(opened)})
            self._show(self._subscriber.receive(opened.plain, now, is_fresh=is_fresh), opened)
        elif opened.drop not in (None, Drop.MALFORMED):
            self._print(refused_as_json(opened, len(datagram)))
        self._changed.set()

    def _count(self, plain: bytes) -> dict[str, Any] | None:
        """Count a message by its kind; a line for what the subscriber says nothing of."""
        try:
            decoded = self._codec.decode(plain)
        except RemoteWireError:
            return None  # the subscriber counts it
        if isinstance(decoded, NetworkMessage):
            space = self._setpoint_groups.get(decoded.writer_group_id or 0) if decoded.publisher_id == 0 else None
            if space is not None and len(decoded.messages) == 1:
                self.kinds["setpoint"] += 1
                return _setpoint(space, decoded.messages[0])
            self.kinds.update(KINDS[FrameKind(part.kind)] for part in decoded.messages)
        elif isinstance(decoded, Probe):
            self.kinds["probe"] += 1
        elif isinstance(decoded, MetaDataAnnouncement):
            self.kinds["metadata"] += 1
        elif isinstance(decoded, ActionMessage):
            self.kinds["action-request" if decoded.is_request else "action-response"] += 1 + len(decoded.others)
            return {"event": "action", "publisher_id": decoded.publisher_id, **action_as_json(decoded)}
        else:
            self.kinds["announcement"] += 1
            return {
                "event": "announcement",
                "publisher_id": decoded.publisher_id,
                "announcement": announcement_as_json(decoded),
            }
        return None

    def _show(self, events: list[SubscriberEvent], opened: OpenedDatagram | None) -> None:
        for event in events:
            if isinstance(event, SourceUnknown):
                if event.datagram is not None and self._transport is not None:
                    self._opener.send(self._transport, event.datagram)
                continue
            shown = _described(event)
            if shown is not None:
                self._print(shown if opened is None else {**shown, **security_as_json(opened)})

    def _print(self, shown: dict[str, Any]) -> None:
        if self._left == 0:
            return
        print_json(shown) if self._as_json else print_line(_as_text(shown))
        self.lines += 1
        if self._left is not None:
            self._left -= 1

    def figures(self) -> dict[str, Any]:
        """What was received, by kind, and what was dropped, by cause."""
        counters = self.counters
        return {
            "messages": counters.messages_in,
            "kinds": dict(self.kinds),
            "gaps": counters.gaps,
            "drops": dict(counters.drops),
            "malformed": dict(counters.malformed),
        }


def _setpoint(space: int, message: DataSetMessage) -> dict[str, Any] | None:
    setpoint = read_setpoint(message)
    if setpoint is None:
        return None
    values = [value if math.isfinite(value) else str(value) for value in setpoint.values]
    fields = {"Lease": setpoint.lease, "Number": setpoint.number, "Echo": setpoint.echo, "Values": values}
    return {"event": "setpoint", "space": space, "data_set_writer_ids": [message.data_set_writer_id], "fields": fields}


def security_as_json(opened: OpenedDatagram) -> dict[str, Any]:
    """The security of a message, as in `pubsub decode --json`."""
    heard = opened.heard
    is_secured = heard is not None and heard.mode is not SecurityMode.NONE
    return {
        "security": {
            "mode": None if heard is None else MODES[heard.mode],
            "token_id": heard.token_id if heard is not None and is_secured else None,
            "verified": opened.verified,
        }
    }


def refused_as_json(opened: OpenedDatagram, size: int) -> dict[str, Any]:
    """The headers of a message that was not opened; nothing of them is proved."""
    heard = opened.heard
    shown: dict[str, Any] = {"event": "secured" if opened.drop is Drop.SECURED else "refused"}
    if opened.drop is not Drop.SECURED:
        shown |= {"drop": opened.drop, "reason": opened.reason}
    if heard is not None:
        has_number = len(heard.nonce) == NONCE_BYTES
        shown |= {
            "publisher_id": heard.publisher_id,
            "writer_group_id": heard.writer_group_id,
            "data_set_writer_ids": list(heard.writer_ids),
            "sequence_number": int.from_bytes(heard.nonce[4:], "little") if has_number else None,
        }
    return {**shown, "bytes": size, **security_as_json(opened)}


def _described(event: SubscriberEvent) -> dict[str, Any] | None:
    """One line of output as data; None for what listeners do not care about."""
    if isinstance(event, DataReceived | EventReceived):
        frame, metadata = event.message, event.metadata
        values = zip(metadata.fields, frame.values, strict=True)
        return {
            "event": "data" if isinstance(event, DataReceived) else "event",
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
    if isinstance(event, SourceStale):
        return {"event": "stale", "topic": event.topic.name}
    if isinstance(event, SourceReturned):
        return {"event": "returned", "topic": event.topic.name}
    return None


def _as_text(shown: dict[str, Any]) -> str:
    event = shown["event"]
    parts: list[str] = [] if event == "data" else [event]
    if "topic" in shown:
        parts.append(shown["topic"])
        if shown.get("name", shown["topic"]) != shown["topic"]:
            parts.append(f"({shown['name']})")
    if "drop" in shown:
        parts.append(shown["drop"])
    for name, label in (
        ("publisher_id", "PublisherId"),
        ("writer_group_id", "WriterGroupId"),
        ("sequence_number", "sequence"),
        ("bytes", "bytes"),
    ):
        if shown.get(name) is not None:
            parts.append(f"{label}={shown[name]}")
    if shown.get("data_set_writer_ids"):
        parts.append(f"DataSetWriterIds={','.join(map(str, shown['data_set_writer_ids']))}")
    for action in shown.get("messages", ()):
        parts.append(f"{action['kind']} {action['data_set_writer_id']} target {action['action_target_id']}")
        parts.append(f"request {action['request_id']} {action['status'] or action['action_state']}")
    if "announcement" in shown:
        parts.append(f"({shown['announcement']['tells']})")
    for name, value in shown.get("fields", {}).items():
        text = value if event == "metadata" else json.dumps(value, ensure_ascii=False)
        parts.append(f"{name}={text}")
    if shown.get("status", "Good") != "Good":
        parts.append(shown["status"])
    if shown.get("time"):
        parts.append(shown["time"])
    if "security" in shown:
        parts.append(_security_text(**shown["security"]))
    if shown.get("reason"):
        parts.append(f"({shown['reason']})")
    return "  ".join(parts)


def _security_text(mode: str | None, token_id: int | None, verified: bool | None) -> str:
    if token_id is None:
        return "unsecured"
    said = {True: "verified", False: "does not verify", None: "not verified"}[verified]
    return f"[{mode}, token {token_id}, {said}]"


def figures_text(figures: dict[str, Any]) -> str:
    """The figures of a listener for people."""
    drops = {**figures["drops"], "kernel": figures["kernel_drops"]}
    dropped = ", ".join(f"{cause} {count}" for cause, count in sorted(drops.items()) if count) or "nothing"
    causes = ", ".join(f"{cause} {count}" for cause, count in sorted(figures["malformed"].items()))
    malformed = f" (malformed: {causes})" if causes else ""
    kinds = ", ".join(f"{kind} {count}" for kind, count in sorted(figures["kinds"].items())) or "none"
    return f"messages: {figures['messages']}, gaps: {figures['gaps']}, dropped: {dropped}{malformed}, kinds: {kinds}"
