"""RecentMessages of the fleet's Object: engineers look at the last PubSub messages, opened (ADR 58)."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any, Final

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import UaFleetError
from ua_fleet.nodes.method_factory import NOT_POSSIBLE, MethodArgument, MethodFactory, Noted, NotValid, caller
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.pubsub.recent import LONGEST_SOURCE, RecentMessage, RecentMessages
from ua_fleet.values import ARRAY, BuiltinType
from ua_fleet.wire.security import SecurityMode

__all__ = ["RecentMessageMethods"]

_TEXT: Final = int(BuiltinType.STRING)
_COUNT: Final = int(BuiltinType.UINT64)
_COUNTS: Final = int(BuiltinType.UINT64 | ARRAY)
_TIMES: Final = int(BuiltinType.DATETIME | ARRAY)
_FLAGS: Final = int(BuiltinType.BOOLEAN | ARRAY)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_BYTES: Final = int(BuiltinType.BYTE_STRING | ARRAY)
_SIZES: Final = int(BuiltinType.UINT32 | ARRAY)
_MODES: Final = {
    SecurityMode.NONE: "None",
    SecurityMode.SIGN: "Sign",
    SecurityMode.SIGN_AND_ENCRYPT: "SignAndEncrypt",
}


class RecentMessageMethods:
    """Answers the Method."""

    def __init__(
        self, server: HardenedServer, parts: NodeFactory, recent: RecentMessages, *, is_encrypted: bool
    ) -> None:
        """Prepare to answer; `build` makes the Method.

        Args:
            server: gets the Method.
            parts: of the fleet.
            recent: the messages that are kept.
            is_encrypted: messages are encrypted on the wire, so the answer with their content is encrypted too.
        """
        self._server, self._recent_messages, self._is_encrypted = server, recent, is_encrypted
        self._methods = MethodFactory(server, parts, lambda _: NOT_POSSIBLE)

    def build(self) -> None:
        """Make the Method and let it be called."""
        node = self._methods.add("Fleet", "RecentMessages", Role.ENGINEER, self._recent, (
            MethodArgument("Source", _TEXT, "whose: a PublisherId, or a UA topic such as ua_2_2_1001; empty: all"),
            MethodArgument("After", _COUNT, "the number of the last message that you have; 0: all that are kept"),
        ), (
            MethodArgument("Numbers", _COUNTS, "of each message; they rise"),
            MethodArgument("Times", _TIMES, "when each was sent or received"),
            MethodArgument("Sent", _FLAGS, "whether the server sent it; else it received it"),
            MethodArgument("Addresses", _TEXTS, "where each came from, or went to alone"),
            MethodArgument("Messages", _BYTES, "the first 4096 bytes of each, with what was encrypted in plain"),
            MethodArgument("Sizes", _SIZES, "bytes of each as a whole"),
            MethodArgument("Opened", _FLAGS, "whether it was let in; else it is as it came"),
            MethodArgument("Security", _TEXTS, "None, Sign or SignAndEncrypt"),
            MethodArgument("Tokens", _SIZES, "SecurityTokenId of each; 0: none"),
            MethodArgument("Chunks", _FLAGS, "whether it went as several datagrams; it is shown put together"),
            MethodArgument("Dropped", _TEXTS, "causes for which it or a part of it was dropped; empty: none"),
            MethodArgument("Lost", _COUNT, "messages that had no place since the last call"),
            MethodArgument("More", int(BuiltinType.BOOLEAN), "whether there are newer ones than fit: call again"),
        ), "The last PubSub messages of the server, opened. They are kept from the first call on, while you call at "
           "least each 15 s.")  # fmt: skip
        context = self._server.context
        context.frequent_methods.add(node)
        if self._is_encrypted:
            context.encrypted_methods.add(node)

    async def _recent(self, source: str, after: int) -> Sequence[Any] | Noted:
        if len(source) > LONGEST_SOURCE:
            raise NotValid(f"Source is longer than {LONGEST_SOURCE} characters")
        answer = self._recent_messages.ask(caller().name, source, after, asyncio.get_running_loop().time())
        if answer.begins:
            self._record(source)
        columns = [_row(message) for message in answer.messages]
        outputs: list[list[Any]] = [[] for _ in range(11)]
        if columns:
            outputs = [list(column) for column in zip(*columns, strict=True)]
        return (*outputs, answer.lost, answer.has_more)

    def _record(self, source: str) -> None:
        """One line for each beginning: one for each call would push all others out of the log."""
        session = current_session.get()
        if session is None:
            raise UaFleetError("no session")
        self._server.context.audit.record("recent_messages", session.caller, "Good", source=source)


def _row(message: RecentMessage) -> tuple[Any, ...]:
    return (
        message.number,
        message.ticks,
        message.is_sent,
        message.address,
        message.data,
        message.size,
        message.is_open,
        _MODES[message.mode],
        message.token_id,
        message.in_chunks,
        message.dropped,
    )
