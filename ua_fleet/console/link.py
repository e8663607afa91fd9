"""One person's OPC UA session at one fleet: it heals by its session key, and says how it is.

    connecting -> live -> away(reason, since) -> live ...      the server is away, restarts, does not answer
    any        -> ended(reason)                                it will not heal by itself: log in again

Feeds run while it is live. One that makes a mistake is begun anew after a while, and costs nothing else.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final, TypeVar

import structlog

from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.console.board import Board
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.failures import OperationRefused, shown_error
from ua_fleet.console.feeds import FEEDS
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters
from ua_fleet.console.rights import Rights, rights_of
from ua_fleet.console.server_clock import ServerClock
from ua_fleet.console.settings import FleetAddress
from ua_fleet.console.shown import shown_time
from ua_fleet.errors import AccessRefused, NotConnected, SendTimeout, UaFleetError
from ua_fleet.printing import harmless
from ua_fleet.values import StatusCode

__all__ = ["NO_LOGIN", "FleetLink", "RunningFeed", "SessionSecret"]

_log: Any = structlog.get_logger("ua_fleet.console")
Answer = TypeVar("Answer")

_TIMEOUT_S: Final = 10.0
_OWN_TIMEOUT_S: Final = 5.0
_BEAT_S: Final = 1.0
_SILENT_S: Final = 3.0
"""A server that has not answered for so long is away; so is what is shown of it."""
_FIRST_BACKOFF_S: Final = 0.25
_LONGEST_BACKOFF_S: Final = 5.0
_FEED_AGAIN_S: Final = 5.0
_LINGER_S: Final = 3.0
"""A feed that nobody wants any more goes on for so long: the next page often wants it again."""
_STATE: Final = "i=2259"
_CURRENT_TIME: Final = "i=2258"
_RIGHTS_EVERY: Final = 5
"""Beats between two looks at what the user may do."""
NO_LOGIN: Final = frozenset(
    {
        int(StatusCode.BAD_USER_ACCESS_DENIED),
        int(StatusCode.BAD_IDENTITY_TOKEN_REJECTED),
        0x8020_0000,  # BadIdentityTokenInvalid
    }
)
"""What a server answers to a user, password or key that it does not take."""
_NO_TRUST: Final = frozenset({int(StatusCode.BAD_SECURITY_CHECKS_FAILED), 0x801A_0000})


@dataclass(frozen=True, slots=True)
class SessionSecret:
    """The key that the server has issued to the console for its user. It is in memory alone."""

    key: str = field(repr=False)
    id: str
    valid_until: datetime
    server_uri: str


class RunningFeed:
    """A feed of a link, shared by all tabs that want it."""

    def __init__(self, kind: FeedKind, parameters: FeedParameters, key: str) -> None:
        self.kind, self.parameters, self.key = kind, parameters, key
        self.board = Board()
        self.wanted_by = 0
        self.task: asyncio.Task[None] | None = None
        self.unwanted_since = 0.0


class FleetLink:
    """The session of a user at a fleet."""

    def __init__(
        self,
        fleet: str,
        address: FleetAddress,
        user: str,
        secret: SessionSecret,
        identity: ClientIdentity,
        counts: ConsoleCounts,
        most_feeds: int,
    ) -> None:
        self.fleet, self.user, self.secret = fleet, user, secret
        self.rights = Rights()
        self._address, self._identity, self._counts, self._most_feeds = address, identity, counts, most_feeds
        self._state, self._reason, self._since = "connecting", "", datetime.now(UTC)
        self._client: FleetClient | None = None
        self._group: asyncio.TaskGroup | None = None
        self._feeds: dict[str, RunningFeed] = {}
        self._listeners: list[Callable[[FleetLink], None]] = []
        self._changed = asyncio.Event()
        self._clock = ServerClock()
        self._own_sessions = 0
        self._is_alone = asyncio.Event()
        self._is_alone.set()

    # ------------------------------------------------------------------ how it is

    @property
    def state(self) -> str:
        """`connecting`, `live`, `away` or `ended`."""
        return self._state

    @property
    def reason(self) -> str:
        """Why it is not live."""
        return self._reason

    @property
    def shown(self) -> dict[str, Any]:
        """How it is, for the page."""
        return {
            "state": self._state,
            "since": shown_time(self._since),
            "reason": harmless(self._reason),
            "user": harmless(self.user),
            "ahead_s": self._clock.ahead_s,
            **self.rights.shown,
        }

    def listen(self, listener: Callable[[FleetLink], None]) -> None:
        """Call a function whenever it is otherwise."""
        self._listeners.append(listener)

    def unlisten(self, listener: Callable[[FleetLink], None]) -> None:
        """Call it no more."""
        self._listeners.remove(listener)

    async def settled(self, timeout_s: float) -> None:
        """Wait until it is no longer connecting for the first time."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while self._state == "connecting":
                    self._changed.clear()
                    await self._changed.wait()

    def _be(self, state: str, reason: str = "") -> None:
        if (state, reason) == (self._state, self._reason):
            return
        if state != self._state:
            self._since = datetime.now(UTC)
            level = _log.info if state in ("live", "connecting") else _log.warning
            level(f"link {state}", fleet=self.fleet, user=self.user, reason=harmless(reason) or None)
        self._state, self._reason = state, reason
        self._tell()

    def _tell(self) -> None:
        self._changed.set()
        for listener in list(self._listeners):
            listener(self)

    # ------------------------------------------------------------------ requests

    async def ask(self, request: Callable[[FleetClient], Awaitable[Answer]], timeout_s: float) -> Answer:
        """Ask the server; raises Refused where it is away, and what the request raises."""
        if self._state == "ended":
            raise OperationRefused(401, self._reason, code=int(StatusCode.BAD_SESSION_ID_INVALID))
        client = self._client
        if client is None or self._state != "live":  # what waits in a server that stands would be done later
            reason = self._reason or "connecting"
            raise OperationRefused(
                503, f"{self.fleet} is not reachable: {reason}", code=int(StatusCode.BAD_NOT_CONNECTED)
            )
        try:
            async with asyncio.timeout(timeout_s):
                return await request(client)
        except TimeoutError:
            raise SendTimeout(
                f"{self.fleet} has not answered within {timeout_s:g} s; whether it was done is not known"
            ) from None

    @asynccontextmanager
    async def own_session(self, most: int) -> AsyncGenerator[FleetClient]:
        """A session beside this one, by the same key, for what must not wait behind anything else.

        Args:
            most: sessions of this kind at once; raises Refused beyond.
        """
        if self._state != "live":
            reason = self._reason or "connecting"
            raise OperationRefused(
                503, f"{self.fleet} is not reachable: {reason}", code=int(StatusCode.BAD_NOT_CONNECTED)
            )
        if self._own_sessions >= most:
            self._counts.drop("too_many_drives")
            raise OperationRefused(429, f"{self.user} drives {self._own_sessions} robots at {self.fleet} already")
        self._own_sessions += 1
        self._is_alone.clear()
        try:
            async with self._connected(_OWN_TIMEOUT_S) as client:
                yield client
        finally:
            self._own_sessions -= 1
            if not self._own_sessions:
                self._is_alone.set()

    async def unused(self) -> None:
        """Wait until no session of its key but its own is open."""
        await self._is_alone.wait()

    def _connected(self, timeout_s: float) -> AbstractAsyncContextManager[FleetClient]:
        return FleetClient.connect(
            self._address.endpoint,
            user=self.user,
            password=self.secret.key,
            identity=self._identity,
            policy=self._address.policy,
            insecure=self._address.insecure,
            server_uri=self.secret.server_uri,
            timeout_s=timeout_s,
        )

    # ------------------------------------------------------------------ feeds

    def open_feed(self, name: str, parameters: FeedParameters) -> RunningFeed:
        """A feed, which one more browser wants from now on; raises Refused where there are too many."""
        key = f"{name} {json.dumps(parameters.model_dump(mode='json'), sort_keys=True)}"
        feed = self._feeds.get(key)
        if feed is None:
            self._clear_unwanted(all_of_them=len(self._feeds) >= self._most_feeds)
            if len(self._feeds) >= self._most_feeds:
                self._counts.drop("too_many_feeds")
                raise OperationRefused(
                    429, f"{self._most_feeds} feeds of {self.user} at {self.fleet} are open; close some pages"
                )
            feed = self._feeds[key] = RunningFeed(FEEDS[name], parameters, key)
            self._begin(feed)
        feed.wanted_by += 1
        return feed

    def close_feed(self, feed: RunningFeed) -> None:
        """One browser less wants a feed."""
        feed.wanted_by -= 1
        feed.unwanted_since = time.monotonic()

    def _clear_unwanted(self, *, all_of_them: bool = False) -> None:
        before = time.monotonic() - (0 if all_of_them else _LINGER_S)
        for feed in [one for one in self._feeds.values() if not one.wanted_by and one.unwanted_since <= before]:
            del self._feeds[feed.key]
            if feed.task is not None:
                feed.task.cancel()

    def _begin(self, feed: RunningFeed) -> None:
        if self._group is not None and self._client is not None:
            feed.task = self._group.create_task(self._run_feed(feed, self._client), name=f"feed {feed.kind.name}")

    async def _run_feed(self, feed: RunningFeed, client: FleetClient) -> None:
        """Run a feed, again and again; whatever goes wrong in it ends here."""
        while True:
            feed.board.restart()
            try:
                await feed.kind.run(client, feed.parameters, feed.board)
            except UaFleetError as error:
                problem: UaFleetError = error
            except BaseExceptionGroup as group:
                problem = _expected(group) or self._mistake(feed, group)
            except Exception as error:  # noqa: BLE001  (one feed, one mistake)
                problem = self._mistake(feed, error)
            else:
                problem = self._mistake(feed, RuntimeError("the feed has ended"))
            _end_if_cancelled()
            if isinstance(problem, NotConnected):
                return  # the link says so
            feed.board.fail(shown_error(problem))
            await asyncio.sleep(_FEED_AGAIN_S)

    def _mistake(self, feed: RunningFeed, error: BaseException) -> UaFleetError:
        self._counts.mistake(f"feed_{feed.kind.name}", error)
        return UaFleetError(f"a mistake of the console's in {feed.kind.name}; it is in its log, and is tried again")

    # ------------------------------------------------------------------ the session

    async def run(self) -> None:
        """Keep the session until it has ended for good, or this is cancelled."""
        backoff_s = _FIRST_BACKOFF_S
        while True:
            try:
                async with self._connected(_TIMEOUT_S) as client:
                    backoff_s = _FIRST_BACKOFF_S
                    await self._serve(client)
            except AccessRefused as error:
                if (reason := self._end_for(error)) is not None:
                    self._be("ended", reason)
                    return
                self._be("away", str(error))
            except UaFleetError as error:
                self._be("away", str(error))
            except Exception as error:  # noqa: BLE001  (a mistake costs one link a moment, and is counted)
                self._counts.mistake("link", error)
                self._be("away", "a mistake of the console's; it is in its log")
            _end_if_cancelled()
            await asyncio.sleep(backoff_s)
            backoff_s = min(2 * backoff_s, _LONGEST_BACKOFF_S)

    def _end_for(self, error: AccessRefused) -> str | None:
        """Why the link cannot heal after this; None: it may."""
        code = int(error.ua_status)
        if code in NO_LOGIN:
            return (
                f"{self.fleet} no longer takes the session key of {self.user}: it was revoked, has ended, or the "
                "password was changed; log in again"
            )
        if code in _NO_TRUST:
            return str(error)
        return None

    async def _serve(self, client: FleetClient) -> None:
        """Be live until the connection is lost."""
        lost = asyncio.Event()
        client.on_lost = lost.set
        self.rights = await rights_of(client)
        try:
            async with asyncio.TaskGroup() as group:
                self._client, self._group = client, group
                for feed in self._feeds.values():
                    self._begin(feed)
                self._be("live")
                group.create_task(self._beat(client), name="beat")
                await lost.wait()
                raise _Lost
        except* _Lost:
            pass
        finally:
            self._client = self._group = None
            for feed in self._feeds.values():
                feed.task = None
        raise NotConnected(f"the connection to {self._address.endpoint} was lost")

    async def _beat(self, client: FleetClient) -> None:
        """Ask the server each second whether it is there; it is away before the connection is."""
        number = 0
        while True:
            await asyncio.sleep(_BEAT_S)
            self._clear_unwanted()
            number += 1
            beat = self._look(client, with_rights=number % _RIGHTS_EVERY == 0)
            waiting = asyncio.ensure_future(beat)
            try:
                done, _ = await asyncio.wait([waiting], timeout=_SILENT_S)
                if not done:
                    self._be("away", f"{self._address.endpoint} has not answered for {_SILENT_S:g} s")
                    await asyncio.wait([waiting])
                waiting.result()
            except UaFleetError as error:
                _log.debug("beat", error=str(error))
                raise _Lost from error
            finally:
                waiting.cancel()
            self._be("live")

    async def _look(self, client: FleetClient, *, with_rights: bool) -> None:
        asked = datetime.now(UTC)
        _, now = await client.read([_STATE, _CURRENT_TIME])
        if self._clock.take(now.exact, asked + (datetime.now(UTC) - asked) / 2):
            self._tell()
        if with_rights and (rights := await rights_of(client)) != self.rights:
            self.rights = rights
            self._tell()


def _end_if_cancelled() -> None:
    """A group of tasks that is cancelled while one of them fails raises what failed, and forgets the cancellation."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


class _Lost(Exception):
    """The connection is gone."""


def _expected(group: BaseExceptionGroup[BaseException]) -> UaFleetError | None:
    """The error of ours of which a group was made, and nothing else."""
    ours, others = group.split(UaFleetError)
    if others is not None:
        return None
    inner: BaseException | None = ours
    while isinstance(inner, BaseExceptionGroup):
        errors: Sequence[BaseException] = inner.exceptions
        inner = errors[-1]
    return inner if isinstance(inner, UaFleetError) else None
