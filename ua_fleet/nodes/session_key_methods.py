"""IssueSessionKey, RevokeSessionKey and ListSessionKeys of the fleet's Object: each user's own keys.

A key issues no key, so that whoever has got hold of one has it no longer than it was issued for.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Any, Final

from ua_fleet.endpoint.audit import Caller
from ua_fleet.endpoint.call_limit import CallLimit
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.session_keys import KeyUnknown, SessionKey, SessionKeys
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.endpoint.users import Role, User
from ua_fleet.errors import UaFleetError
from ua_fleet.nodes.method_factory import (
    NOT_FOUND,
    NOT_POSSIBLE,
    MethodArgument,
    MethodFactory,
    Noted,
    NotValid,
    caller,
)
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.values import ARRAY, BuiltinType, ticks_from_unix_ns

__all__ = ["SessionKeyMethods"]

_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_SECONDS: Final = int(BuiltinType.DOUBLE)
_TIME: Final = int(BuiltinType.DATETIME)
_TIMES: Final = int(BuiltinType.DATETIME | ARRAY)


class SessionKeyMethods:
    """Answers the Methods."""

    def __init__(self, server: HardenedServer, parts: NodeFactory) -> None:
        """Prepare to answer; `build` makes the Methods."""
        self._server = server
        self._keys: SessionKeys = server.context.session_keys
        self._methods = MethodFactory(server, parts, _code_of)
        # Each one is a write to the disk.
        self._limit = CallLimit(0, 1.0)

    def build(self) -> None:
        """Make the Methods and let them be called."""
        key_id = MethodArgument("KeyId", _TEXT, "names the key in lists and in the audit log; no secret")
        issue = self._methods.add("Fleet", "IssueSessionKey", Role.OBSERVER, self._issue, (
            MethodArgument("Name", _TEXT, "what you call it, such as the machine that keeps it; at most 64 characters"),
            MethodArgument("Lifetime", _SECONDS, "seconds; 0: as long as the server lets a key live"),
        ), (
            MethodArgument("Key", _TEXT, "to be given as the password of this user; shown this once"),
            key_id,
            MethodArgument("ValidUntil", _TIME, "when it ends, if nothing ends it before"),
        ), "Issue a session key to the user who calls. A session that was opened with one gets none.")  # fmt: skip
        revoke = self._methods.add(
            "Fleet",
            "RevokeSessionKey",
            Role.OBSERVER,
            self._revoke,
            (key_id,),
            (),
            "End a session key of the user who calls, and the sessions that were opened with it.",
        )
        listed = self._methods.add("Fleet", "ListSessionKeys", Role.OBSERVER, self._list, (), (
            MethodArgument("KeyIds", _TEXTS, "of each"),
            MethodArgument("Names", _TEXTS, "of each"),
            MethodArgument("Issued", _TIMES, "when each was issued"),
            MethodArgument("ValidUntil", _TIMES, "when each ends"),
        ), "The session keys of the user who calls.")  # fmt: skip
        context = self._server.context
        context.secret_methods.add(issue)
        for node in (issue, revoke, listed):
            if context.allow_none_security:
                context.method_rules[node] = _is_person
            else:
                self._server.restrict_method(node, _is_person)

    async def _issue(self, name: str, lifetime_s: float) -> Sequence[Any] | Noted:
        user = caller()
        self._check_limit(user)
        if not self._keys.longest_s:
            raise _NotNow("this server issues no session keys (server.max_session_key_days: 0)")
        if user.session_key:
            raise _NotNow("this session was opened with a session key; open one with the password")
        if not 0 <= lifetime_s < float("inf"):
            raise NotValid("Lifetime is no number of seconds")
        issued = await asyncio.to_thread(self._keys.issue, user.name, name, lifetime_s, time.time())
        self._record("issued", issued.key, until=round(issued.key.until))
        for key in issued.ended:
            self._record("ended", key, reason="made room for a newer key")
        outputs = (str(issued.text), issued.key.id, _ticks(issued.key.until))
        if not issued.ended:
            return outputs
        names = ", ".join(f"{key.name} ({key.id})" for key in issued.ended)
        return Noted(outputs, f"ended to make room: {names}")

    async def _revoke(self, key_id: str) -> Sequence[Any]:
        user = caller()
        self._check_limit(user)
        self._record("revoked", await asyncio.to_thread(self._keys.revoke, user.name, key_id, time.time()))
        return ()

    async def _list(self) -> Sequence[Any]:
        keys = self._keys.list(time.time(), caller().name)
        return (
            [key.id for key in keys],
            [key.name for key in keys],
            [_ticks(key.issued) for key in keys],
            [_ticks(key.until) for key in keys],
        )

    def _check_limit(self, user: User) -> None:
        if not self._limit.take(user.name, time.monotonic()):
            raise Refusal(StatusCodes.BadServerTooBusy, "too many session keys at once")

    def _record(self, what: str, key: SessionKey, **details: Any) -> None:
        session = current_session.get()
        by = session.caller if session is not None else Caller("server", key.user)
        self._server.context.audit.record("session_key", by, "Good", what=what, key=key.id, name=key.name, **details)


class _NotNow(UaFleetError):
    """There is no key for this caller."""

    remedy = "Log in with the password, over a channel with Sign & Encrypt."


def _code_of(error: UaFleetError) -> int:
    return NOT_FOUND if isinstance(error, KeyUnknown) else NOT_POSSIBLE


def _is_person(user: User) -> bool:
    return not user.anonymous and not user.bridge


def _ticks(time_s: float) -> int:
    return ticks_from_unix_ns(int(time_s * 1e9))
