"""The console's routes: the page, login, operations, and the WebSocket of live data."""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from collections.abc import Mapping
from functools import partial
from hashlib import sha256
from typing import Any, Final
from urllib.parse import unquote

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from ua_fleet import __version__
from ua_fleet.console.board import encoded
from ua_fleet.console.connections import Connections
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.drive import DriveSocket
from ua_fleet.console.failures import OperationRefused, invalid_parameters, refused_by
from ua_fleet.console.link import FleetLink
from ua_fleet.console.live import PageSocket
from ua_fleet.console.operations import OPERATIONS
from ua_fleet.console.operations.kinds import Bytes, OperationKind, OperationParameters
from ua_fleet.console.origins import RequestOrigin, TrustedProxies, is_allowed_host, is_own_origin
from ua_fleet.console.page import SECURITY_HEADERS, Page
from ua_fleet.console.people import People
from ua_fleet.console.repeats import KEY_CHARACTERS, NOT_KNOWN
from ua_fleet.console.sessions import BrowserSession
from ua_fleet.console.settings import ConsoleSettings
from ua_fleet.console.sockets import CLOSE_FORBIDDEN, CLOSE_LOGGED_OUT, CLOSE_TOO_MANY
from ua_fleet.errors import UaFleetError

__all__ = ["ConsoleApp"]

_LOGIN_BYTES: Final = 8192
_BODY_S: Final = 20.0
_SEEN: Final = "ua_fleet.origin"
"""Where the middleware leaves how the browser sees the console."""


class _Login(BaseModel):
    model_config = ConfigDict(extra="forbid")
    fleet: str = Field(min_length=1, max_length=100)
    user: str = Field(min_length=1, max_length=256)
    password: str = Field(min_length=1, max_length=1024, repr=False)


class _Logout(BaseModel):
    model_config = ConfigDict(extra="forbid")
    fleet: str | None = Field(default=None, max_length=100)


class ConsoleApp:
    """What uvicorn serves."""

    def __init__(
        self,
        settings: ConsoleSettings,
        people: People,
        counts: ConsoleCounts,
        cookie: str,
        page: Page | None = None,
        connections: Connections | None = None,
    ) -> None:
        """Put it together.

        Args:
            settings: checked.
            people: who is logged in.
            counts: of what is refused.
            cookie: its name, without the prefix that it has under TLS.
            page: the page's files; by default those of the package.
            connections: those that are open, where they are counted.
        """
        self._settings, self._people, self._counts = settings, people, counts
        self._proxies = TrustedProxies(settings.trusted_proxies)
        self._connections = connections or Connections(self._proxies, settings.limits.connections_per_address, counts)
        self._page = page or Page()
        self._cookie_name = cookie
        self._at_once: Counter[str] = Counter()
        self._sockets = 0
        routes = [
            Route("/api/fleets", self._fleets),
            Route("/api/me", self._me),
            Route("/api/login", self._login, methods=["POST"]),
            Route("/api/logout", self._logout, methods=["POST"]),
            Route("/api/{fleet}/{operation}", self._operate, methods=["POST"]),
            WebSocketRoute("/api/live", partial(self._serve, kind=PageSocket)),
            WebSocketRoute("/api/drive", partial(self._serve, kind=DriveSocket)),
            Route("/healthz", self._health),
            Route("/{path:path}", self._file),
        ]
        handlers: Any = {UaFleetError: self._failed, HTTPException: self._no_route, Exception: self._mistaken}
        starlette = Starlette(routes=routes, exception_handlers=handlers)
        self.asgi: ASGIApp = _Guarded(starlette, settings, self._proxies, counts)

    # ------------------------------------------------------------------ who it is

    def _cookie(self, seen: RequestOrigin) -> str:
        """The cookie's name. `__Host-` would want the path `/`, which behind a proxy belongs to others too."""
        return f"{'__Secure-' if seen.scheme == 'https' else ''}{self._cookie_name}"

    def _set_cookie(self, seen: RequestOrigin, token: str, *attributes: str) -> str:
        # Without a path: the browser takes that of this request, whatever a proxy has put before it.
        secure = ("Secure",) if seen.scheme == "https" else ()
        return "; ".join((f"{self._cookie(seen)}={token}", *attributes, "HttpOnly", "SameSite=Strict", *secure))

    def _session(self, scope: Scope, cookies: Mapping[str, str]) -> BrowserSession | None:
        token = cookies.get(self._cookie(scope[_SEEN]), "")
        return self._people.sessions.find(token, time.monotonic()) if token else None

    def _checked(self, request: Request) -> BrowserSession:
        """The session of a POST, whose token against forged requests is right."""
        session = self._session(request.scope, request.cookies)
        if session is None:
            self._counts.drop("not_logged_in")
            raise OperationRefused(401, "log in: there is no session, or it has ended")
        if not session.is_csrf(request.headers.get("x-csrf", "")):
            self._counts.drop("wrong_csrf")
            raise OperationRefused(403, "the header X-CSRF is missing or wrong; load the page again")
        return session

    async def _body(self, request: Request, most: int) -> bytes:
        content_type = request.headers.get("content-type", "").split(";")[0].strip().lower()
        if content_type != "application/json":
            raise OperationRefused(400, "the content type is not application/json")
        parts = bytearray()
        try:
            async with asyncio.timeout(_BODY_S):
                async for part in request.stream():
                    parts += part
                    if len(parts) > most:
                        self._counts.drop("too_large")
                        raise OperationRefused(413, f"the request is larger than {most} bytes")
        except TimeoutError:
            self._counts.drop("too_slow")
            raise OperationRefused(408, f"the request was not whole within {_BODY_S:g} s") from None
        return bytes(parts)

    # ------------------------------------------------------------------ routes

    async def _fleets(self, request: Request) -> Response:
        fleets = [
            {"name": name, "title": one.title or name, "endpoint": one.endpoint}
            for name, one in self._settings.fleets.items()
        ]
        answer: dict[str, Any] = {"fleets": fleets, "version": __version__}
        if self._settings.banner:
            answer["banner"] = self._settings.banner
        return _json(answer)

    async def _me(self, request: Request) -> Response:
        session = self._session(request.scope, request.cookies)
        if session is None:
            raise OperationRefused(401, "log in: there is no session, or it has ended")
        return _json(self._shown(session))

    def _shown(self, session: BrowserSession) -> dict[str, Any]:
        links: dict[str, FleetLink] = session.logins
        return {"fleets": {name: link.shown for name, link in links.items()}, "csrf": session.csrf}

    async def _login(self, request: Request) -> Response:
        body = await self._body(request, _LOGIN_BYTES)
        try:
            asked = _Login.model_validate_json(body)
        except ValidationError as error:
            raise invalid_parameters(error, "login") from None
        seen: RequestOrigin = request.scope[_SEEN]
        before = self._session(request.scope, request.cookies)
        session, token = await self._people.login(before, asked.fleet, asked.user, asked.password, seen.address)
        answer = _json(self._shown(session))
        if token is not None:
            answer.headers["set-cookie"] = self._set_cookie(seen, token)
        return answer

    async def _logout(self, request: Request) -> Response:
        session = self._checked(request)
        try:
            asked = _Logout.model_validate_json(await self._body(request, _LOGIN_BYTES) or b"{}")
        except ValidationError as error:
            raise invalid_parameters(error, "logout") from None
        self._people.logout(session, asked.fleet)
        answer = _json({"fleets": {name: link.shown for name, link in session.logins.items()}})
        if not session.logins:
            answer.headers["set-cookie"] = self._set_cookie(request.scope[_SEEN], "", "Max-Age=0")
        return answer

    async def _operate(self, request: Request) -> Response:
        session = self._checked(request)
        kind = OPERATIONS.get(request.path_params["operation"])
        if kind is None:
            raise OperationRefused(404, f"there is no operation {request.path_params['operation']!r}")
        fleet = request.path_params["fleet"]
        link: FleetLink | None = session.logins.get(fleet)
        if link is None:
            raise OperationRefused(401, f"you are not logged in at {fleet}")
        shown = unquote(request.headers.get("x-user", ""))
        if shown and shown != link.shown["user"]:
            self._counts.drop("other_user")
            raise OperationRefused(
                401, f"nothing was done: this browser is logged in at {fleet} as {link.user} now, and not as {shown}"
            )
        body = await self._body(request, self._settings.limits.request_bytes)
        try:
            asked = kind.parameters.model_validate_json(body or b"{}")
        except ValidationError as error:
            raise invalid_parameters(error, kind.name) from None
        self._people.sessions.use(session, time.monotonic())
        key = request.headers.get("idempotency-key", "")[:KEY_CHARACTERS]
        if not key or kind.role == "observer":  # what only asks may ask twice
            result = await self._ask(link, kind, asked)
            return _framed(result) if isinstance(result, Bytes) else _json({"result": result})
        return await self._once(
            session, (key, fleet, link.user, kind.name, sha256(body).hexdigest()), link, kind, asked
        )

    async def _ask(self, link: FleetLink, kind: OperationKind, asked: OperationParameters) -> Any:
        """Have an operation done; raises Refused."""
        who = f"{link.fleet}/{link.user}"
        if self._at_once[who] >= self._settings.limits.requests_at_once:
            self._counts.drop("too_many_requests")
            raise OperationRefused(
                429, f"{self._at_once[who]} requests of {link.user} wait for an answer", retry_after_s=1.0
            )
        self._at_once[who] += 1
        try:
            return await link.ask(lambda client: kind.run(client, asked), kind.timeout_s)
        except UaFleetError as error:
            raise refused_by(error, method=kind.method) from error
        finally:
            self._at_once[who] -= 1
            if not self._at_once[who]:
                del self._at_once[who]

    async def _once(
        self,
        session: BrowserSession,
        command: tuple[str, ...],
        link: FleetLink,
        kind: OperationKind,
        asked: OperationParameters,
    ) -> Response:
        """Carry a command out, or answer what it was answered when this page sent it before; raises Refused."""
        before = session.answers.find(command, time.monotonic())
        if before is not None:
            status, text = await asyncio.shield(before)
            again = _text(text, status)
            again.headers["idempotent-replayed"] = "true"
            return again
        if not session.answers.begin(command):
            self._counts.drop("answer_forgotten")
        answer = NOT_KNOWN
        try:
            result = await self._ask(link, kind, asked)
            answer = 200, f'{{"result":{encoded(result)}}}'
        except OperationRefused as refused:
            answer = refused.http_status, encoded({"error": refused.body})
            raise
        finally:
            session.answers.end(command, answer, time.monotonic())
        return _text(answer[1])

    async def _serve(self, socket: WebSocket, kind: type[PageSocket | DriveSocket]) -> None:
        seen: RequestOrigin = socket.scope[_SEEN]
        if not is_own_origin(socket.headers.get("origin", ""), seen):
            self._counts.drop("wrong_origin")
            await socket.close(CLOSE_FORBIDDEN)
            return
        session = self._session(socket.scope, socket.cookies)
        limits = self._settings.limits
        await socket.accept()  # so that the page is told why
        if session is None:
            self._counts.drop("not_logged_in")
            await socket.close(CLOSE_LOGGED_OUT, "log in")
        elif self._sockets >= limits.sockets or session.sockets >= limits.sockets_per_session:
            self._counts.drop("too_many_sockets")
            await socket.close(CLOSE_TOO_MANY, "too many tabs are open")
        else:
            self._sockets += 1
            try:
                with self._connections.logged_in(socket.scope.get("client")):
                    await kind(socket, session, self._people, self._counts, limits).run()
            finally:
                self._sockets -= 1

    @property
    def sockets(self) -> int:
        """Pages that are open."""
        return self._sockets

    async def _health(self, request: Request) -> Response:
        links = Counter(link.state for link in self._people.links)
        return _json(
            {
                "status": "ok",
                "version": __version__,
                "sessions": len(self._people.sessions),
                "sockets": self._sockets,
                "links": dict(links),
                "drops": {cause: count for cause, count in self._counts.drops.items() if count},
                "mistakes": dict(self._counts.mistakes.counts),
            }
        )

    async def _file(self, request: Request) -> Response:
        if self._page.is_other:  # and else without a thread, of which others may have all
            await asyncio.to_thread(self._page.read)
        return self._page.answer(request.path_params["path"], request)

    # ------------------------------------------------------------------ errors

    async def _failed(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, UaFleetError)
        refused = refused_by(error)
        answer = _json({"error": refused.body}, refused.http_status)
        if refused.retry_after_s:
            answer.headers["retry-after"] = str(max(1, round(refused.retry_after_s)))
        return answer

    async def _no_route(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return _json({"error": {"message": f"{error.detail}: {request.method} {request.url.path}"}}, error.status_code)

    async def _mistaken(self, request: Request, error: Exception) -> Response:
        self._counts.mistake("request", error)
        return _json({"error": {"message": "a mistake of the console's; it is in its log"}}, 500)


def _json(value: Any, status: int = 200) -> Response:
    return _text(encoded(value), status)


def _text(text: str, status: int = 200) -> Response:
    return Response(text, status, {"cache-control": "no-store"}, "application/json")


def _framed(result: Bytes) -> Response:
    """The length of the head as four bytes, the highest first; the head as JSON; the bytes."""
    head = encoded(result.head).encode()
    body = b"".join((len(head).to_bytes(4, "big"), head, result.content))
    return Response(body, 200, {"cache-control": "no-store"}, "application/octet-stream")


class _Guarded:
    """Checks Host and, of what changes something, Origin; adds the headers of safety to every answer."""

    def __init__(self, app: ASGIApp, settings: ConsoleSettings, proxies: TrustedProxies, counts: ConsoleCounts) -> None:
        self._app, self._settings, self._proxies, self._counts = app, settings, proxies, counts
        self._headers = [(name.encode(), value.encode()) for name, value in SECURITY_HEADERS.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers: dict[str, str] = {}
        for raw_name, raw_value in scope["headers"]:
            name, value = raw_name.decode("latin-1"), raw_value.decode("latin-1")
            # A proxy may add a line of its own where another one would go on in the line that there is: RFC 9110, 5.3.
            headers[name] = f"{headers[name]}, {value}" if name in headers else value
        scheme = "https" if scope["scheme"] in ("https", "wss") else "http"
        peer = str(scope["client"][0]) if scope.get("client") else ""
        seen = scope[_SEEN] = self._proxies.seen(peer, scheme, headers)

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *self._headers]
                if seen.scheme == "https":
                    message["headers"].append((b"strict-transport-security", b"max-age=31536000"))
            await send(message)

        refused = self._refused(scope, seen, headers)
        if refused is None:
            await self._app(scope, receive, guarded)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": CLOSE_FORBIDDEN, "reason": ""})
        else:
            await _json({"error": refused.body}, refused.http_status)(scope, receive, guarded)

    def _refused(self, scope: Scope, seen: RequestOrigin, headers: Mapping[str, str]) -> OperationRefused | None:
        if not is_allowed_host(seen.host, self._settings.allowed_hosts, is_loopback=self._settings.is_loopback):
            self._counts.drop("wrong_host")
            return OperationRefused(
                400, f"the console is not reached by the name {json.dumps(seen.host[:100])}; see allowed_hosts"
            )
        changes = scope["type"] == "http" and scope["method"] not in ("GET", "HEAD")
        if changes and not is_own_origin(headers.get("origin", ""), seen):
            self._counts.drop("wrong_origin")
            return OperationRefused(403, "the request does not come from the console's own page (Origin)")
        return None
