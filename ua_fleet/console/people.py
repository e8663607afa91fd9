"""Who is logged in: browsers by their cookies, and for each user of a fleet one link, however many browsers."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Generator, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final, NoReturn

import structlog

from ua_fleet.client import ClientIdentity, FleetClient, issue_session_key, revoke_session_key
from ua_fleet.console.attempts import Attempts
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.failures import OperationRefused, refused_by
from ua_fleet.console.link import NO_LOGIN, FleetLink, SessionSecret
from ua_fleet.console.origins import source_of
from ua_fleet.console.sessions import BrowserSession, BrowserSessions
from ua_fleet.console.settings import ConsoleSettings
from ua_fleet.errors import AccessRefused, UaFleetError
from ua_fleet.printing import harmless
from ua_fleet.values import StatusCode

__all__ = ["People"]

_log: Any = structlog.get_logger("ua_fleet.console")

_CONNECT_S: Final = 10.0
_SETTLE_S: Final = 5.0
_REVOKE_S: Final = 2.0
_END_S: Final = 1.0
"""The console's end waits so long for servers to end their keys."""
_KEY_SLACK: Final = timedelta(minutes=5)
"""A second browser shares the first one's key where that ends no more than this before its own login."""
_SWEEP_S: Final = 5.0
_PAIR: Final = (4, 15.0)
"""Logins of one user from one address that may fail at once, and seconds for one more. The server's own limit is 5."""
_ADDRESS: Final = (12, 10.0)
_USER: Final = (12, 10.0)
_AT_ONCE_OF_USER: Final = 2
"""Logins of one user that wait for the server."""

Spawn = Callable[[Coroutine[Any, Any, None], str], asyncio.Task[None]]


class _HeldLink:
    """A link, and the browsers that it was opened for."""

    def __init__(self, link: FleetLink, task: asyncio.Task[None]) -> None:
        self.link, self.task = link, task
        self.browsers: list[BrowserSession] = []


class People:
    """All who are logged in at this console."""

    def __init__(
        self, settings: ConsoleSettings, identity: ClientIdentity, counts: ConsoleCounts, spawn: Spawn
    ) -> None:
        self._settings, self._identity, self._counts, self._spawn = settings, identity, counts, spawn
        limits = settings.limits
        self.sessions = BrowserSessions(settings.session_idle_s, settings.session_max_s, limits.sessions)
        self._links: dict[tuple[str, str], _HeldLink] = {}
        self._pairs, self._addresses, self._users = Attempts(*_PAIR), Attempts(*_ADDRESS), Attempts(*_USER)
        self._logging_in: Counter[str] = Counter()
        self._on_end: list[Callable[[BrowserSession], None]] = []

    @property
    def links(self) -> list[FleetLink]:
        """All links that there are."""
        return [held.link for held in self._links.values()]

    def on_end(self, heard: Callable[[BrowserSession], None]) -> None:
        """Call a function when a browser's session has ended, or its logins have changed."""
        self._on_end.append(heard)

    def on_end_no_more(self, heard: Callable[[BrowserSession], None]) -> None:
        """Call it no more."""
        self._on_end.remove(heard)

    # ------------------------------------------------------------------ login

    async def login(
        self, session: BrowserSession | None, fleet: str, user: str, password: str, address: str
    ) -> tuple[BrowserSession, str | None]:
        """Log a browser in; its session, and the token of a new cookie where it had none. Raises Refused."""
        where = self._settings.fleets.get(fleet)
        if where is None:
            raise OperationRefused(404, f"there is no fleet {fleet!r}", field="fleet")
        source, who = source_of(address), f"{fleet}/{user}"
        names = ((self._pairs, f"{who}@{source}"), (self._addresses, source), (self._users, who))
        now = time.monotonic()
        wait_s = max(attempts.wait_s(name, now) for attempts, name in names)
        if wait_s > 0:
            self._counts.drop("login_limited")
            raise OperationRefused(
                429, f"too many failed logins; try again in {wait_s:.0f} s", retry_after_s=wait_s, field="password"
            )
        if self._needs_new(session) and self.sessions.is_full:
            raise self._full()
        with self._one_more_login(fleet, source, who), self._one_more_attempt(names, now):
            secret = await self._secret(fleet, user, password, address)
        return await self._admit(session, fleet, user, secret)

    @contextlib.contextmanager
    def _one_more_login(self, fleet: str, source: str, who: str) -> Generator[None]:
        """Let a login begin: so many at once of a fleet, half of them of an address, a few of a user. Raises Refused.

        A fleet that stands, or somebody whose password is right each time, would have the places of all others.
        """
        most = self._settings.limits.logins_at_once
        places = {f"fleet {fleet}": most, f"from {source}": max(1, most // 2), f"user {who}": _AT_ONCE_OF_USER}
        if any(self._logging_in[place] >= at_once for place, at_once in places.items()):
            self._counts.drop("login_limited")
            raise OperationRefused(
                429, "too many people log in at this moment; try again in a second", retry_after_s=1.0
            )
        self._logging_in.update(places.keys())
        try:
            yield
        finally:
            self._logging_in.subtract(places.keys())
            self._logging_in = +self._logging_in  # without those of 0

    @contextlib.contextmanager
    def _one_more_attempt(self, names: Sequence[tuple[Attempts, str]], now: float) -> Generator[None]:
        """Count an attempt, and forgive it where no user or password was refused, as by a fleet that is away.

        One that ends without an answer, since the browser went away, stays counted: it may have been a guess.
        """
        for attempts, name in names:
            attempts.count(name, now)
        try:
            yield
        except OperationRefused as error:
            if error.code in NO_LOGIN:
                raise
            self._forgive(names)
            raise
        self._forgive(names)

    def _forgive(self, names: Sequence[tuple[Attempts, str]]) -> None:
        for attempts, name in names:
            attempts.forgive(name)

    async def _secret(self, fleet: str, user: str, password: str, address: str) -> SessionSecret:
        """A session key of a user who knows the password."""
        where = self._settings.fleets[fleet]
        try:
            async with asyncio.timeout(_CONNECT_S):
                async with FleetClient.connect(
                    where.endpoint,
                    user=user,
                    password=password,
                    identity=self._identity,
                    policy=where.policy,
                    insecure=where.insecure,
                    timeout_s=_CONNECT_S,
                ) as client:
                    issued = await issue_session_key(
                        client, f"console on {socket.gethostname()}"[:64], self._settings.session_max_s + 60
                    )
                    return SessionSecret(issued.key, issued.id, issued.valid_until, client.server_uri)
        except TimeoutError:
            raise OperationRefused(
                504, f"{fleet} has not answered within {_CONNECT_S:g} s", code=int(StatusCode.BAD_TIMEOUT)
            ) from None
        except AccessRefused as error:
            self._refuse_login(error, fleet, user, address)
        except UaFleetError as error:
            raise refused_by(error) from error

    def _refuse_login(self, error: AccessRefused, fleet: str, user: str, address: str) -> NoReturn:
        code = int(error.ua_status)
        if code != StatusCode.BAD_USER_ACCESS_DENIED:
            # Not the password: the server does not trust us, or is not the one that we know.
            refused = refused_by(error)
            raise OperationRefused(502, str(refused), code=code) from error
        self._counts.drop("login_failed")
        _log.warning("login failed", fleet=fleet, user=harmless(user)[:100], address=address)
        raise OperationRefused(401, f"{fleet} refuses this user or password", code=code, field="password") from error

    async def _admit(
        self, session: BrowserSession | None, fleet: str, user: str, secret: SessionSecret
    ) -> tuple[BrowserSession, str | None]:
        token: str | None = None
        if session is None or self._needs_new(session):  # it may have ended meanwhile
            begun = self.sessions.begin(time.monotonic())
            if begun is None:  # others were quicker
                self._spawn(self._revoke(fleet, user, secret), "revoke the key of a login without a place")
                raise self._full()
            session, token = begun
        held = self._held(fleet, user, secret)
        if session.logins.get(fleet) is not held.link:
            if fleet in session.logins:
                self._release(session, fleet)
            session.logins[fleet] = held.link
            held.browsers.append(session)
            self._make_room(held, session)
        self.sessions.use(session, time.monotonic())
        await held.link.settled(_SETTLE_S)
        _log.info("logged in", fleet=fleet, user=harmless(user)[:100], browsers=len(held.browsers))
        self._tell(session)
        return session, token

    def _needs_new(self, session: BrowserSession | None) -> bool:
        return session is None or self.sessions.is_over(session, time.monotonic())

    def _full(self) -> OperationRefused:
        self._counts.drop("too_many_sessions")
        return OperationRefused(429, "too many people are logged in; try again later", retry_after_s=60.0)

    def _held(self, fleet: str, user: str, secret: SessionSecret) -> _HeldLink:
        """The link of a user, which goes on with its key, or begins with this one."""
        held = self._links.get((fleet, user))
        until = datetime.now(UTC) + timedelta(seconds=self._settings.session_max_s) - _KEY_SLACK
        if held is not None and held.link.state != "ended" and held.link.secret.valid_until >= until:
            self._spawn(self._revoke(fleet, user, secret), "revoke the key of a second login")
            return held
        browsers: list[BrowserSession] = []
        if held is not None:
            browsers = held.browsers
            held.task.cancel()
            self._spawn(self._revoke_unused(held.link), "revoke the key of an older login")
        link = FleetLink(
            fleet, self._settings.fleets[fleet], user, secret, self._identity, self._counts,
            self._settings.limits.feeds_per_user,
        )  # fmt: skip
        new = self._links[fleet, user] = _HeldLink(link, self._spawn(link.run(), f"link {fleet}"))
        new.browsers = browsers
        for browser in browsers:
            browser.logins[fleet] = link
            self._tell(browser)
        return new

    def _make_room(self, held: _HeldLink, newest: BrowserSession) -> None:
        while len(held.browsers) > self._settings.limits.sessions_per_user:
            oldest = min((one for one in held.browsers if one is not newest), key=lambda one: one.used_s)
            self._counts.drop("too_many_sessions")
            self.logout(oldest)

    # ------------------------------------------------------------------ logout

    def logout(self, session: BrowserSession, fleet: str | None = None) -> None:
        """Log a browser out of one fleet, or of all; with the last one its session is over."""
        for name in [fleet] if fleet is not None else list(session.logins):
            if name in session.logins:
                self._release(session, name)
        if not session.logins:
            self.sessions.end(session)
        self._tell(session)

    def _release(self, session: BrowserSession, fleet: str) -> None:
        link: FleetLink = session.logins.pop(fleet)
        held = self._links.get((fleet, link.user))
        if held is None or held.link is not link:
            return
        held.browsers.remove(session)
        if not held.browsers:
            del self._links[fleet, link.user]
            held.task.cancel()
            self._spawn(self._revoke(fleet, link.user, link.secret), "revoke")

    async def _revoke_unused(self, link: FleetLink) -> None:
        """Have the server end the key of a link once nobody drives a robot by it: another login stops no robot."""
        await link.unused()
        await self._revoke(link.fleet, link.user, link.secret)

    async def _revoke(self, fleet: str, user: str, secret: SessionSecret) -> None:
        """Have the server end a key; where that fails it ends by itself."""
        where = self._settings.fleets[fleet]
        try:
            async with asyncio.timeout(_REVOKE_S):
                async with FleetClient.connect(
                    where.endpoint, user=user, password=secret.key, identity=self._identity, policy=where.policy,
                    insecure=where.insecure, server_uri=secret.server_uri, timeout_s=_REVOKE_S,
                ) as client:  # fmt: skip
                    await revoke_session_key(client, secret.id)
        except AccessRefused:
            return  # it has ended already
        except (UaFleetError, TimeoutError) as error:
            self._counts.drop("key_not_revoked")
            _log.warning(
                "a session key could not be revoked: it ends by itself",
                fleet=fleet,
                user=harmless(user)[:100],
                key=secret.id,
                until=secret.valid_until.isoformat(timespec="seconds"),
                error=harmless(str(error)),
            )

    def _tell(self, session: BrowserSession) -> None:
        for heard in list(self._on_end):
            heard(session)

    # ------------------------------------------------------------------ as time goes on

    async def sweep(self) -> None:
        """End sessions whose time is over, until cancelled."""
        while True:
            await asyncio.sleep(_SWEEP_S)
            for session in self.sessions.expired(time.monotonic()):
                self.logout(session)

    async def close(self) -> None:
        """End all: servers are told as far as they answer within a second."""
        held = list(self._links.values())
        self._links.clear()
        for one in held:
            one.task.cancel()
        revoking: list[Awaitable[None]] = [self._revoke(one.link.fleet, one.link.user, one.link.secret) for one in held]
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_END_S):
                await asyncio.gather(*revoking, return_exceptions=True)
