# pyright: basic, reportMissingImports=false
"""One call of a ROS 1 service over TCPROS, with what rospy.ServiceProxy does not tell: whether the robot was asked.

rospy waits for ever, and for the master too, and has one error for everything. Here a call that fails says whether
nothing was begun, the robot said no, or nobody knows.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from typing import Any, Final
from urllib.parse import urlsplit

import genpy

from ua_bridges.ros1.classes import response_layout
from ua_bridges.ros1.layout import TooMany
from ua_bridges.ros1.tcpros import Broken, keep_alive, read_header, write_header
from ua_fleet.values import StatusCode

__all__ = ["CallFailed", "CallLost", "NotAsked", "exchange"]

CONNECT_S: Final = 2.0
"""For the connection, and for the handshake."""
MOST_BYTES: Final = 64 << 20
"""The largest response that is read."""
_LENGTH: Final = struct.Struct("<I")


class NotAsked(Exception):
    """The service was not asked, so that nothing was begun."""

    def __init__(self, status: int, text: str) -> None:
        self.status = status
        super().__init__(text)


class CallFailed(Exception):
    """The service says that it failed."""


class CallLost(Exception):
    """The service was asked, or may have been, and no answer comes."""


def exchange(
    uri: str,
    name: str,
    service_class: Any,
    caller: str,
    request: bytes,
    connected: Callable[[socket.socket], None],
    asked: Callable[[], None],
) -> Any:
    """Call a service; the response.

    Args:
        uri: of the service, as the master knows it.
        name: of the service.
        service_class: its type.
        caller: name of this node.
        request: the serialised request.
        connected: gets the socket; shutting it down ends the call.
        asked: called when the request is on its way.

    Raises:
        NotAsked, CallFailed, CallLost: with the reason.
    """
    try:
        link = _connect(uri, name, service_class, caller, connected)
    except (OSError, ValueError, Broken) as error:
        said = f"the service {name} does not answer at {uri} ({error}); start the robot's node"
        raise NotAsked(StatusCode.BAD_NO_COMMUNICATION, said) from error
    with link:
        asked()
        try:
            link.sendall(_LENGTH.pack(len(request)) + request)
            succeeded = _read(link, 1) != b"\x00"
            (size,) = _LENGTH.unpack(_read(link, _LENGTH.size))
            if size > MOST_BYTES:
                raise CallLost(f"the response of {name} has {size} bytes; at most {MOST_BYTES} are read")
            content = _read(link, size)
        except OSError as error:
            raise CallLost(f"the server of {name} went before it answered ({error})") from error
    if not succeeded:
        raise CallFailed(content.decode(errors="replace") or f"the service {name} failed and did not say why")
    try:
        response_layout(service_class).check(content)
        return service_class._response_class().deserialize(content)  # noqa: SLF001 - genpy's name for it
    except (genpy.DeserializationError, UnicodeDecodeError, TooMany) as error:
        raise CallLost(f"the response of {name} cannot be read: {error}") from error


def _connect(
    uri: str, name: str, service_class: Any, caller: str, connected: Callable[[socket.socket], None]
) -> socket.socket:
    parts = urlsplit(uri)
    link = socket.create_connection((parts.hostname or "", parts.port or 0), CONNECT_S)
    try:
        connected(link)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        keep_alive(link)
        fields = {"callerid": caller, "service": name, "md5sum": service_class._md5sum}  # noqa: SLF001
        deadline = time.monotonic() + CONNECT_S
        write_header(link, fields, deadline)
        header = read_header(link, deadline)
        if "error" in header:
            raise NotAsked(StatusCode.BAD_TYPE_MISMATCH, f"the service {name} refused the call: {header['error']}")
        link.settimeout(None)  # how long it may take is the skill's to say
    except BaseException:
        link.close()
        raise
    return link


def _read(link: socket.socket, count: int) -> bytes:
    content = bytearray()
    while len(content) < count:
        more = link.recv(min(count - len(content), 1 << 20))
        if not more:
            raise ConnectionResetError("the connection was closed")
        content += more
    return bytes(content)
