"""One line of the audit log as a message of RFC 5424, and where such messages go."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlsplit

__all__ = ["Destination", "Origin", "encode_message", "frame_message", "parse_destination"]

_LOG_AUDIT: Final = 13
"""Facility `log audit` (RFC 5424 table 1)."""
_WARNING, _INFORMATIONAL = 4, 6
"""Severities (RFC 5424 table 2)."""
_TLS_PORT: Final = 6514
"""RFC 5425 4.1."""
_PLAIN_PORT: Final = 514
_UNPRINTABLE: Final = re.compile(r"[^\x21-\x7e]")
_NIL: Final = "-"
APP_NAME: Final = "ua-fleet"


@dataclass(frozen=True, slots=True)
class Destination:
    """Where messages go."""

    scheme: str
    """`tls`, `tcp`, `udp` or `unix`."""
    host: str = ""
    port: int = 0
    path: str = ""
    """Of the socket of `unix`."""

    def __str__(self) -> str:
        """As in `fleet.yaml`."""
        if self.scheme == "unix":
            return f"unix:{self.path}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


@dataclass(frozen=True, slots=True)
class Origin:
    """Who sends."""

    host: str
    process_id: int


def parse_destination(url: str) -> Destination:
    """`tls://host[:6514]`, `tcp://host[:514]`, `udp://host[:514]` or `unix:/path`; raises ValueError."""
    parts = urlsplit(url)
    if parts.scheme == "unix":
        if parts.netloc or not parts.path.startswith("/"):
            raise ValueError("write unix:/path/of/the/socket")
        return Destination("unix", path=parts.path)
    if parts.scheme not in ("tls", "tcp", "udp"):
        raise ValueError("write tls://HOST:PORT, tcp://HOST:PORT, udp://HOST:PORT or unix:/PATH")
    port = parts.port  # raises for what is no port
    if not parts.hostname or parts.path.strip("/") or parts.query or parts.username is not None or port == 0:
        raise ValueError(f"write {parts.scheme}://HOST:PORT and nothing else")
    return Destination(parts.scheme, parts.hostname, port or (_TLS_PORT if parts.scheme == "tls" else _PLAIN_PORT))


def encode_message(line: bytes, *, time: str, event: str, refused: bool, origin: Origin) -> bytes:
    """A message (RFC 5424 6) with a line of the log as its MSG, without structured data.

    Args:
        line: of the log, ASCII.
        time: of the line, RFC 3339.
        event: becomes the MSGID.
        refused: severity warning in place of informational.
        origin: becomes HOSTNAME and PROCID.
    """
    priority = _LOG_AUDIT * 8 + (_WARNING if refused else _INFORMATIONAL)
    host = _printable(origin.host, 255)
    head = f"<{priority}>1 {time or _NIL} {host} {APP_NAME} {origin.process_id} {_printable(event, 32)} {_NIL} "
    return head.encode("ascii") + line


def frame_message(message: bytes) -> bytes:
    """A message in a stream, with its length before it (RFC 5425 4.3, octet counting of RFC 6587 3.4.1)."""
    return b"%d %s" % (len(message), message)


def _printable(text: str, most: int) -> str:
    """A name of the header: PRINTUSASCII, of bounded length."""
    return _UNPRINTABLE.sub("", text)[:most] or _NIL
