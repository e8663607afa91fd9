"""The WebSocket of live data: what one page wants, and what its outbox sends it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from ua_fleet.console.attempts import Attempts
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.failures import OperationRefused, invalid_parameters
from ua_fleet.console.feeds import FEEDS
from ua_fleet.console.feeds.kinds import FeedParameters
from ua_fleet.console.link import FleetLink, RunningFeed
from ua_fleet.console.outbox import PageOutbox
from ua_fleet.console.people import People
from ua_fleet.console.sessions import BrowserSession
from ua_fleet.console.settings import ConsoleLimits
from ua_fleet.console.shown import shown_time
from ua_fleet.console.sockets import CLOSE_LOGGED_OUT, CLOSE_TOO_MANY, Closed, FirstSaid, close, first_said, said_by

__all__ = ["PageSocket"]


_FeedName = Annotated[str, Field(max_length=100)]
_MOST_REFUSED: Final = 256
"""Refusals that wait for a page which confirms nothing."""


class _Want(BaseModel):
    model_config = ConfigDict(extra="forbid")
    fleet: str = Field(max_length=100)
    feed: str = Field(max_length=100)
    parameters: dict[str, Any] = Field(default_factory=dict[str, Any])


class _Said(FirstSaid):
    """A message of the page."""

    want: dict[_FeedName, _Want] = Field(default_factory=dict[str, _Want], max_length=200)
    drop: list[str] = Field(default_factory=list[str], max_length=1000)
    seen: int | None = None
    active: bool | None = None


@dataclass(frozen=True, slots=True)
class _Wanted:
    """A feed that there is, with parameters that are its."""

    fleet: str
    feed: str
    parameters: FeedParameters


class PageSocket:
    """One page's WebSocket, accepted; its session, Origin and Host are checked."""

    def __init__(
        self, socket: WebSocket, session: BrowserSession, people: People, counts: ConsoleCounts, limits: ConsoleLimits
    ) -> None:
        self._socket, self._session, self._people = socket, session, people
        self._counts, self._limits = counts, limits
        self._waiting = asyncio.Event()
        self._outbox = PageOutbox(self._waiting.set)
        self._wanted: dict[str, _Wanted] = {}
        self._open: dict[str, tuple[FleetLink, RunningFeed]] = {}
        self._links: dict[str, FleetLink] = {}
        self._over = asyncio.Event()
        """Set once its session has ended."""
        self._messages = Attempts(int(4 * limits.messages_per_s) + 1, 1 / limits.messages_per_s)

    async def run(self) -> None:
        """Serve the page until it goes, or its session ends."""
        self._people.on_end(self._session_changed)
        self._session.sockets += 1
        try:
            self._take_first(await first_said(self._socket, _Said, self._session, self._counts))
            async with asyncio.TaskGroup() as group:
                group.create_task(self._read())
                group.create_task(self._send())
                group.create_task(self._until_over())
        except* Closed as ended:
            first_one = ended.exceptions[0]
            if isinstance(first_one, Closed):
                await close(self._socket, first_one.code, first_one.reason)
        except* (WebSocketDisconnect, RuntimeError):
            pass  # the page has gone, while we read or while we sent
        finally:
            self._session.sockets -= 1
            self._people.on_end_no_more(self._session_changed)
            self._outbox.close()
            for name in list(self._open):
                self._shut(name)
            for link in self._links.values():
                link.unlisten(self._link_changed)

    # ------------------------------------------------------------------ what the page says

    async def _read(self) -> None:
        while True:
            said = await said_by(self._socket, _Said, self._counts)
            now = time.monotonic()
            if self._messages.wait_s("", now) > 0:
                self._counts.drop("too_many_messages")
                raise Closed(CLOSE_TOO_MANY, "too many messages")
            self._messages.count("", now)
            self._take(said)

    def _take_first(self, said: _Said) -> None:
        self._follow_links()
        self._take(said)

    def _take(self, said: _Said) -> None:
        if said.seen is not None:
            self._outbox.seen(said.seen)
        if said.active:  # not what it wants: a page that nobody looks at wants it again after each outage
            self._people.sessions.use(self._session, time.monotonic())
        for name in said.drop:
            self._wanted.pop(name, None)
            self._shut(name)
            self._outbox.drop(name)
        for name, want in said.want.items():
            self._want(name, want)
        if self._outbox.waiting_refusals > _MOST_REFUSED:
            self._counts.drop("too_many_feeds")
            raise Closed(CLOSE_TOO_MANY, "too many feeds were refused")

    def _want(self, name: str, want: _Want) -> None:
        """Keep what the page wants, where it can ever be had, and follow it."""
        self._wanted.pop(name, None)
        try:
            self._wanted[name] = self._checked(want)
        except OperationRefused as refused:
            self._shut(name)
            self._outbox.refuse(name, refused.body)
        else:
            self._follow(name)

    def _checked(self, want: _Want) -> _Wanted:
        if len(self._wanted) >= self._limits.feeds_per_socket:
            self._counts.drop("too_many_feeds")
            raise OperationRefused(429, f"a page may have {self._limits.feeds_per_socket} feeds")
        kind = FEEDS.get(want.feed)
        if kind is None:
            raise OperationRefused(404, f"there is no feed {want.feed!r}")
        try:
            return _Wanted(want.fleet, want.feed, kind.parameters.model_validate(want.parameters))
        except ValidationError as error:
            raise invalid_parameters(error, want.feed) from None

    def _follow(self, name: str) -> None:
        before = self._open.pop(name, None)
        try:
            link, feed = self._opened(self._wanted[name])
        except OperationRefused as refused:
            self._outbox.refuse(name, refused.body)
        else:
            self._open[name] = link, feed
            self._outbox.want(name, feed.board)
        if before is not None:  # after the new one: it may be the same
            before[0].close_feed(before[1])

    def _opened(self, want: _Wanted) -> tuple[FleetLink, RunningFeed]:
        link: FleetLink | None = self._session.logins.get(want.fleet)
        if link is None:
            raise OperationRefused(401, f"you are not logged in at {want.fleet}")
        return link, link.open_feed(want.feed, want.parameters)

    def _shut(self, name: str) -> None:
        opened = self._open.pop(name, None)
        if opened is not None:
            opened[0].close_feed(opened[1])

    # ------------------------------------------------------------------ what it is told

    def _session_changed(self, session: BrowserSession) -> None:
        if session is self._session:
            self._follow_links()
            for name, want in list(self._wanted.items()):
                if name not in self._open or self._open[name][0] is not self._session.logins.get(want.fleet):
                    self._follow(name)
            if not session.logins:
                self._over.set()

    def _follow_links(self) -> None:
        now = dict(self._session.logins)
        for fleet, link in list(self._links.items()):
            if now.get(fleet) is not link:
                del self._links[fleet]
                link.unlisten(self._link_changed)
                if fleet not in now:
                    self._outbox.link(fleet, {"state": "ended", "since": None, "reason": "logged out"})
        for fleet, link in now.items():
            if fleet not in self._links:
                self._links[fleet] = link
                link.listen(self._link_changed)
                self._link_changed(link)

    def _link_changed(self, link: FleetLink) -> None:
        self._outbox.link(link.fleet, link.shown)

    async def _until_over(self) -> None:
        """End it with its session, even while what is sent waits for a page that takes nothing."""
        sessions = self._people.sessions
        while not sessions.is_over(self._session, now := time.monotonic()):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(sessions.ends_s(self._session) - now):
                    await self._over.wait()
        raise Closed(CLOSE_LOGGED_OUT, "logged out")

    async def _send(self) -> None:
        while True:
            self._waiting.clear()
            text = self._outbox.next(time.monotonic(), shown_time(datetime.now(UTC)) or "")
            if text is not None:
                await self._socket.send_text(text)
                continue
            due_s = self._outbox.due_s(time.monotonic())
            try:
                async with asyncio.timeout(due_s):
                    await self._waiting.wait()
            except TimeoutError:
                continue
