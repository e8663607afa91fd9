"""Sends the audit log to a syslog server, at the same time as it goes to the files.

A thread sends, so that a server that hangs holds nobody up. What waits is bounded: when the syslog server is away for
longer than that lasts, the newest lines are dropped and counted; the numbers in the lines show which. Before each
message it is seen whether the peer has closed the stream; what the network had taken by then is lost, since syslog has
no acknowledgements.
"""

from __future__ import annotations

import os
import select
import socket
import ssl
import threading
from collections import deque
from pathlib import Path
from typing import Final

import structlog

from ua_fleet.endpoint.audit.chain import parse_line
from ua_fleet.endpoint.audit.syslog_message import Destination, Origin, encode_message, frame_message
from ua_fleet.errors import ServerStartError

__all__ = ["SyslogSender", "tls_context"]

_log = structlog.get_logger("ua_fleet.audit")

MOST_WAITING: Final = 20_000
TIMEOUT_S: Final = 5.0
FIRST_PAUSE_S: Final = 0.5
LONGEST_PAUSE_S: Final = 30.0
LAST_S: Final = 2.0
"""So long the end of the server waits for what is not delivered yet."""


def tls_context(authority: Path | None, certificate: Path | None, key: Path | None) -> ssl.SSLContext:
    """TLS 1.2 or newer, by which the syslog server proves its name (RFC 5425 5); raises ServerStartError.

    Args:
        authority: certificates (PEM) of who may have signed the server's; None for those that the machine trusts.
        certificate: ours (PEM), where the server wants one.
        key: of that; None where it stands in the same file.
    """
    try:
        context = ssl.create_default_context(cafile=authority)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        if certificate is not None:
            context.load_cert_chain(certificate, key)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        files = ", ".join(str(path) for path in (authority, certificate, key) if path is not None)
        raise ServerStartError(f"server.audit.syslog: {files}: cannot be used for TLS ({reason})") from error
    return context


class SyslogSender:
    """A copy of the audit log at a syslog server."""

    def __init__(self, to: Destination, context: ssl.SSLContext | None = None) -> None:
        """Begin to send.

        Args:
            to: where to; only `tls` needs a context.
            context: of TLS.
        """
        self._to, self._context = to, context
        self._origin = Origin(socket.gethostname(), os.getpid())
        self._waiting: deque[bytes] = deque()
        self._changed = threading.Condition()
        self._over = False
        self._socket: socket.socket | None = None
        self.is_away = False
        """Whether the syslog server took nothing when it was tried last."""
        self.dropped = 0
        """Lines that could not be delivered."""
        self.sent = 0
        self._thread = threading.Thread(target=self._run, name="audit syslog", daemon=True)
        self._thread.start()

    def put(self, line: bytes, event: str, *, refused: bool) -> None:
        """Take a line, without waiting."""
        time = str((parse_line(line) or {}).get("time", ""))
        message = encode_message(line, time=time, event=event, refused=refused, origin=self._origin)
        with self._changed:
            if len(self._waiting) >= MOST_WAITING:
                self.dropped += 1
                return
            self._waiting.append(message)
            self._changed.notify()

    def close(self) -> None:
        """Send what waits, for a short while, and end."""
        with self._changed:
            self._changed.wait_for(lambda: not self._waiting or self.is_away, LAST_S)
            self._over = True
            self.dropped += len(self._waiting)
            self._changed.notify_all()
        self._thread.join(LAST_S)

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._over)
                if self._over:
                    break
                message = self._waiting[0]
            try:
                self._send(message)
            except (OSError, ValueError) as error:
                self._away(error)
                with self._changed:
                    self._changed.wait_for(lambda: self._over, pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
                continue
            pause_s = FIRST_PAUSE_S
            with self._changed:
                self._waiting.popleft()
                self.sent += 1
                if not self._waiting:
                    self._changed.notify_all()
        self._disconnect()

    def _send(self, message: bytes) -> None:
        if self._socket is not None and self._to.scheme in ("tls", "tcp") and _is_closed(self._socket):
            self._disconnect()
        if self._socket is None:
            self._socket = self._connect()
        self._socket.sendall(frame_message(message) if self._to.scheme in ("tls", "tcp") else message)
        if self.is_away:
            self.is_away = False
            _log.info("the syslog server takes the audit log again", to=str(self._to), dropped=self.dropped)

    def _connect(self) -> socket.socket:
        to = self._to
        if to.scheme == "unix":
            local = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            try:
                local.settimeout(TIMEOUT_S)
                local.connect(to.path)
            except BaseException:
                local.close()
                raise
            return local
        if to.scheme == "udp":
            family, kind, protocol, _, address = socket.getaddrinfo(to.host, to.port, type=socket.SOCK_DGRAM)[0]
            datagrams = socket.socket(family, kind, protocol)
            datagrams.connect(address)
            return datagrams
        stream = socket.create_connection((to.host, to.port), TIMEOUT_S)
        if self._context is None:
            return stream
        try:
            return self._context.wrap_socket(stream, server_hostname=to.host)
        except BaseException:
            stream.close()
            raise

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _away(self, error: Exception) -> None:
        self._disconnect()
        if not self.is_away:
            self.is_away = True
            reason = str(error) or type(error).__name__
            _log.error(
                "the syslog server does not take the audit log; it is tried again", to=str(self._to), reason=reason
            )


def _is_closed(stream: socket.socket) -> bool:
    """Whether the peer has closed, or says what nobody here listens to."""
    poll = select.poll()
    poll.register(stream, select.POLLIN)
    if not poll.poll(0):
        return False
    if isinstance(stream, ssl.SSLSocket):
        # Session tickets of TLS 1.3 come as data of the protocol, of which nothing is to be read.
        stream.setblocking(False)
        try:
            return not stream.recv(4096)
        except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
            return False
        finally:
            stream.settimeout(TIMEOUT_S)
    return not stream.recv(4096)
