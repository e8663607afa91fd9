"""The WebSocket by which a page drives one robot: one lease at most, which lives and ends with it.

    page -> console   {"csrf", "fleet", "user", "robot", "take_over"}   first: Acquire
                      {"n", "echo", "values"}                   setpoints, each 20 to 50 ms while it is held
                      {"release": true}
    console -> page   {"held": {...}}                           the lease, the axes and the times of it
                      {"counter", "taken", "answered", ...}     whatever the bridge says, at once
                      {"over": {...}}                           the last: refused, or why it is over

It has an OPC UA session of its own at the server. So no live data wait before setpoints on any connection, a lease is
this page's and not that of all tabs of its user, and it ends when the connection does.

The browser carries the echo: a setpoint goes on with the counter that the browser has seen. Nothing here keeps a lease
but what comes from the browser.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import Any, Final, NoReturn

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat
from starlette.websockets import WebSocket, WebSocketDisconnect

from ua_fleet.client import DrivingLease, driving, teleoperation_info
from ua_fleet.console.attempts import Attempts
from ua_fleet.console.board import encoded
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.failures import refused_by
from ua_fleet.console.feeds.teleoperation import teleoperation_shown
from ua_fleet.console.link import FleetLink
from ua_fleet.console.people import People
from ua_fleet.console.sessions import BrowserSession
from ua_fleet.console.setpoints import SetpointDesk, Wish
from ua_fleet.console.settings import ConsoleLimits
from ua_fleet.console.sockets import (
    CLOSE_INVALID,
    CLOSE_LOGGED_OUT,
    CLOSE_OVER,
    CLOSE_REFUSED,
    CLOSE_SILENT,
    CLOSE_TOO_MANY,
    Closed,
    FirstSaid,
    close,
    first_said,
    said_by,
)
from ua_fleet.errors import UaFleetError
from ua_fleet.printing import harmless

__all__ = ["DriveSocket"]

_SILENT_S: Final = 2.0
"""A browser that says nothing for so long, or a bridge of which nothing is heard, has no lease any more."""
_LOOK_S: Final = 0.25
_RELEASE_S: Final = 2.0
_ACTIVE_S: Final = 10.0
"""So often at most a setpoint that moves the robot counts as something that a person does."""
_UINT32: Final = 0xFFFF_FFFF


class _First(FirstSaid):
    """Which robot a page wants to drive."""

    fleet: str = Field(default="", max_length=100)
    user: str = Field(default="", max_length=1000)
    """As whom the page drives, as far as it shows; empty: it does not say."""
    robot: str = Field(default="", max_length=1000)
    take_over: bool = False


class _Said(BaseModel):
    """A message of a page that drives."""

    model_config = ConfigDict(extra="forbid", strict=True)
    n: int = Field(default=0, ge=0, le=_UINT32)
    echo: int = Field(default=0, ge=0, le=_UINT32)
    values: list[FiniteFloat] = Field(default_factory=list[float], max_length=100)
    release: bool = False


class DriveSocket:
    """One page's WebSocket for driving, accepted; its session, Origin and Host are checked."""

    def __init__(
        self, socket: WebSocket, session: BrowserSession, people: People, counts: ConsoleCounts, limits: ConsoleLimits
    ) -> None:
        self._socket, self._session, self._people = socket, session, people
        self._counts, self._limits = counts, limits
        self._messages = Attempts(int(2 * limits.setpoints_per_s) + 1, 1 / limits.setpoints_per_s)
        self._link: FleetLink | None = None
        self._lease: DrivingLease | None = None
        self._desk = SetpointDesk(0.0)
        self._wished = asyncio.Event()
        self._stir = asyncio.Event()
        """Set when it may be over."""
        self._is_gone = self._is_released = False
        self._heard_at = self._active_at = 0.0
        self._is_ending = False

    async def run(self) -> None:
        """Serve the page until it goes, its lease is over, or its session ends."""
        self._people.on_end(self._session_changed)
        self._session.sockets += 1
        try:
            first = await first_said(self._socket, _First, self._session, self._counts)
            async with asyncio.TaskGroup() as group:
                group.create_task(self._read())
                group.create_task(self._hold(first))
        except* Closed as ended:
            first_one = ended.exceptions[0]
            if isinstance(first_one, Closed):
                await close(self._socket, first_one.code, first_one.reason)
        except* (WebSocketDisconnect, RuntimeError):
            pass  # the page has gone, while we read or while we sent
        finally:
            self._session.sockets -= 1
            self._people.on_end_no_more(self._session_changed)

    def _session_changed(self, session: BrowserSession) -> None:
        link = self._link
        if session is not self._session or link is None:
            return
        now: FleetLink | None = session.logins.get(link.fleet)
        if now is None or now.user != link.user:
            self._is_gone = True
            self._stir.set()

    async def _end(self, code: int, reason: str, said: dict[str, Any] | None = None) -> NoReturn:
        """Tell the page, close, and end all of it; the robot is given back after that, since it may take a while."""
        if not self._is_ending:
            self._is_ending = True
            if said is not None:
                await self._send({"over": said})
            await close(self._socket, code, reason)
        raise Closed(code, reason)

    async def _send(self, message: dict[str, Any]) -> None:
        await self._socket.send_text(encoded(message))

    # ------------------------------------------------------------------ the lease

    async def _hold(self, first: _First) -> None:
        link: FleetLink | None = self._session.logins.get(first.fleet)
        if link is None:
            self._counts.drop("not_logged_in")
            said = f"you are not logged in at {harmless(first.fleet)}"
            await self._end(CLOSE_LOGGED_OUT, said, {"message": said})
        if first.user and first.user != link.shown["user"]:
            self._counts.drop("other_user")
            said = (
                f"no robot is driven: this browser is logged in at {link.fleet} as {link.user} now, "
                f"and not as {harmless(first.user)}"
            )
            await self._end(CLOSE_LOGGED_OUT, said, {"message": said})
        self._link = link
        self._people.sessions.use(self._session, time.monotonic())
        try:
            async with link.own_session(self._limits.drives_per_user) as client:
                info = await teleoperation_info(client, first.robot)
                self._desk = SetpointDesk(info.deadman_s)
                async with driving(client, info, take_over=first.take_over, renew=False) as lease:
                    await self._drive(lease)
        except UaFleetError as error:
            refused = refused_by(error, method=f"{'taking over' if first.take_over else 'driving'} a robot")
            code = CLOSE_OVER if self._lease is not None else CLOSE_REFUSED
            await self._end(code, str(refused), refused.body)

    async def _drive(self, lease: DrivingLease) -> None:
        self._lease, self._heard_at = lease, time.monotonic()
        held = {"robot": harmless(lease.info.robot), "lease": lease.number, "counter": lease.counter}
        self._desk.told(lease.counter, time.monotonic())
        await self._send(
            {"held": {**held, "taken_from": harmless(lease.taken_from), **teleoperation_shown(lease.info)}}
        )
        async with asyncio.TaskGroup() as group:
            group.create_task(self._pass_on(lease))
            group.create_task(self._look_after(lease))
            group.create_task(self._tell(lease))

    async def _pass_on(self, lease: DrivingLease) -> None:
        """Send setpoints to the server, one after the other, and of those that wait the newest."""
        while True:
            await self._wished.wait()
            self._wished.clear()
            wish = self._desk.next()
            if wish is None:
                continue
            try:
                number = await lease.drive(wish.values, echo=wish.echo)
            except UaFleetError as error:
                refused = refused_by(error, method="driving a robot")
                await self._end(CLOSE_OVER, lease.over or str(refused), refused.body)
            self._desk.sent(wish, number)
            lease.changed.set()

    async def _tell(self, lease: DrivingLease) -> None:
        """Tell the page what the bridge says, at once; to a page that is slow the newest alone."""
        last: dict[str, Any] = {}
        while True:
            status = lease.status
            message: dict[str, Any] = {
                "counter": lease.counter,
                "taken": self._desk.taken(status.last_number) if status.lease == lease.number else 0,
                "answered": self._desk.answered,
                "server_ms": round(lease.round_trip_s * 1000, 1),
                "state": status.state,
                "output": list(status.output),
                "drops": dict(status.drops),
                "dropped": dict(self._desk.drops),
            }
            if message != last:
                self._desk.told(lease.counter, time.monotonic())
                await self._send(message)
                last = message
            await lease.changed.wait()
            lease.changed.clear()
            if lease.over:
                self._stir.set()

    async def _look_after(self, lease: DrivingLease) -> None:
        """End it when it is over, for whatever reason."""
        while True:
            if lease.over:
                await self._end(CLOSE_OVER, lease.over, {"message": harmless(lease.over)})
            if self._is_gone:
                await self._end(CLOSE_LOGGED_OUT, "logged out", {"message": "logged out"})
            if self._is_released:
                await self._release(lease)
            if time.monotonic() - self._heard_at > _SILENT_S:
                self._counts.drop("drive_silent")
                said = f"the page has said nothing for {_SILENT_S:g} s"
                await self._end(CLOSE_SILENT, said, {"message": said})
            if lease.age_s > _SILENT_S:
                said = f"nothing is heard of the server or the bridge for {_SILENT_S:g} s"
                await self._end(CLOSE_OVER, said, {"message": said})
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_LOOK_S):
                    await self._stir.wait()
            self._stir.clear()

    async def _release(self, lease: DrivingLease) -> NoReturn:
        try:
            async with asyncio.timeout(_RELEASE_S):
                await lease.release()
        except (UaFleetError, TimeoutError) as error:
            said = f"released; the server has not confirmed it: {str(error) or 'no answer'}"
            await self._end(CLOSE_OVER, said, {"message": harmless(said)})
        await self._end(1000, "released", {"message": "released"})

    # ------------------------------------------------------------------ what the page says

    async def _read(self) -> None:
        while True:
            try:
                said = await said_by(self._socket, _Said, self._counts)
            except Closed as closed:
                await self._end(closed.code, closed.reason)
            self._heard_at = now = time.monotonic()
            if self._messages.wait_s("", now) > 0:
                self._counts.drop("too_many_messages")
                await self._end(CLOSE_TOO_MANY, "too many messages")
            self._messages.count("", now)
            if said.release:
                self._is_released = True
                self._stir.set()
            else:
                await self._take(said, now)

    async def _take(self, said: _Said, now: float) -> None:
        lease = self._lease
        if lease is None or not said.n or len(said.values) != len(lease.info.axes):
            self._counts.drop("invalid")
            axes = "no robot is held" if lease is None else f"a setpoint has n and {len(lease.info.axes)} values"
            await self._end(CLOSE_INVALID, f"not a setpoint: {axes}")
        if cause := self._desk.take(Wish(said.n, said.echo, tuple(said.values)), now):
            self._counts.drop(cause)
        self._wished.set()
        if any(said.values) and now - self._active_at >= _ACTIVE_S:
            self._active_at = now
            self._people.sessions.use(self._session, now)
