"""What stands on a TCPROS link: connection headers, and lengths. Nothing is believed that the other side says.

A length is a claim: memory is taken for what came, never for what was announced, and what takes too long is over.
"""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import time
import xmlrpc.client
from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import urlsplit

__all__ = [
    "MOST_MESSAGE_BYTES",
    "SILENT_S",
    "Broken",
    "ask",
    "has_declarations",
    "has_undelivered",
    "is_there",
    "keep_alive",
    "outlast",
    "read_header",
    "read_message",
    "topic_address",
    "unanswered_s",
    "write_header",
]

MOST_HEADER_BYTES: Final = 1 << 18
"""Of a connection header. The longest definition that is understood has 100,000 characters."""
MOST_MESSAGE_BYTES: Final = 64 << 20
"""Of one message: an image of 4000 x 4000 points and 4 bytes each."""
MOST_ANSWER_BYTES: Final = 1 << 16
"""Of the answer to a call of another node."""
KEEPALIVE_IDLE_S: Final = 3
KEEPALIVE_INTERVAL_S: Final = 1
KEEPALIVE_PROBES: Final = 3
"""A host that lost its power says nothing more: after 3 + 3 * 1 s its link counts as gone (rospy waits 150 s)."""
SILENT_S: Final = float(KEEPALIVE_IDLE_S + KEEPALIVE_PROBES * KEEPALIVE_INTERVAL_S)
"""The other end of a link that has acknowledged nothing for so long is away."""
OUTAGE_S: Final = 130
"""For so long a link to a subscriber outlasts that. rospy keeps its own end for 60 + 9 * 10 s, and has no other."""
_MOST_RETRY_MS: Final = 1000
_TCP_RTO_MAX_MS: Final = 44
"""Linux 6.15; the socket module does not name it."""
_TCP_INFO: Final = struct.Struct("8x16xI28xI")
"""Of linux/tcp.h, `tcpi_unacked` and `tcpi_last_ack_recv` (ms)."""

_LENGTH: Final = struct.Struct("<I")
_BLOCK: Final = 1 << 20
_HTTP_LENGTH = re.compile(rb"\r\ncontent-length:[ \t]*(\d{1,9})[ \t]*\r\n", re.IGNORECASE)


class Broken(Exception):
    """The other side does what no node should; one line for people."""


def keep_alive(link: socket.socket) -> None:
    """Have the kernel notice soon when a connection's other end vanishes without a word."""
    link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEPALIVE_IDLE_S)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEPALIVE_INTERVAL_S)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEPALIVE_PROBES)


def outlast(link: socket.socket) -> None:
    """Have a link to a subscriber outlast an outage of the network; `unanswered_s` tells that there is one."""
    keep_alive(link)
    # It takes the place of the number of probes, and holds for what was sent and is not acknowledged, too.
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, OUTAGE_S * 1000)
    with contextlib.suppress(OSError):  # an older kernel tries again ever more seldom: after as long as the outage was
        link.setsockopt(socket.IPPROTO_TCP, _TCP_RTO_MAX_MS, _MOST_RETRY_MS)


def _tcp_info(link: socket.socket) -> tuple[int, int]:
    unacknowledged, last_ack_ms = _TCP_INFO.unpack(link.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO.size))
    return unacknowledged, last_ack_ms


def unanswered_s(link: socket.socket) -> float:
    """How long ago the other end's kernel acknowledged anything; some 3 s where `keep_alive` holds it."""
    try:
        return _tcp_info(link)[1] / 1000
    except OSError:
        return float("inf")


def has_undelivered(link: socket.socket) -> bool:
    """Whether bytes were sent that the other end's kernel has not acknowledged."""
    try:
        return _tcp_info(link)[0] > 0
    except OSError:
        return False


def _receive(link: socket.socket, most: int, deadline: float, what: str) -> bytes:
    """Some bytes, at most so many, before the time is over."""
    left = deadline - time.monotonic()
    try:
        if left <= 0:
            raise TimeoutError
        link.settimeout(left)
        more = link.recv(min(most, _BLOCK))
    except TimeoutError:
        raise Broken(f"it did not send {what} in time") from None
    if not more:
        raise ConnectionResetError(f"the connection was closed before {what} had come")
    return more


def _exactly(link: socket.socket, count: int, deadline: float, what: str) -> bytes:
    content = bytearray()
    while len(content) < count:
        content += _receive(link, count - len(content), deadline, what)
    return bytes(content)


def write_header(link: socket.socket, fields: Mapping[str, str], deadline: float) -> None:
    """Send a connection header."""
    pairs = [f"{name}={value}".encode() for name, value in fields.items()]
    content = b"".join(_LENGTH.pack(len(pair)) + pair for pair in pairs)
    link.settimeout(max(deadline - time.monotonic(), 0.001))
    link.sendall(_LENGTH.pack(len(content)) + content)


def read_header(link: socket.socket, deadline: float) -> dict[str, str]:
    """The connection header that the other side sends. What is not UTF-8 in it is replaced: comments are in it.

    Args:
        link: a connected socket; its timeout is changed.
        deadline: until when all of it has to be there, in seconds of `time.monotonic`.

    Raises:
        Broken: it is none, too long, or too late.
        OSError: the link ended.
    """
    what = "its connection header"
    (size,) = _LENGTH.unpack(_exactly(link, _LENGTH.size, deadline, what))
    if size > MOST_HEADER_BYTES:
        raise Broken(f"its connection header has {size} bytes, at most {MOST_HEADER_BYTES} are read")
    content = _exactly(link, size, deadline, what)
    fields: dict[str, str] = {}
    at = 0
    while at < size:
        if at + _LENGTH.size > size:
            raise Broken("its connection header ends within a length")
        (length,) = _LENGTH.unpack_from(content, at)
        at += _LENGTH.size
        if at + length > size:
            raise Broken("a field of its connection header is longer than the header")
        name, equals, value = content[at : at + length].partition(b"=")
        if not equals:
            raise Broken("a field of its connection header has no `=`")
        fields[name.decode(errors="replace")] = value.decode(errors="replace")
        at += length
    return fields


def read_message(stream: Any) -> bytes:
    """The next message, from the buffered reader of a link that waits without a timeout.

    Raises:
        Broken: it is longer than any message.
        OSError: the link ended.
    """
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise ConnectionResetError("the link was closed")
    (size,) = _LENGTH.unpack(head)
    if size > MOST_MESSAGE_BYTES:
        raise Broken(f"it announces a message of {size} bytes, at most {MOST_MESSAGE_BYTES} are read")
    if size <= _BLOCK:
        content: bytes = stream.read(size)
    else:
        content = b"".join(_blocks(stream, size))
    if len(content) < size:
        raise ConnectionResetError("the link was closed within a message")
    return content


def _blocks(stream: Any, size: int) -> list[bytes]:
    blocks: list[bytes] = []
    while size > 0 and (block := stream.read(min(size, _BLOCK))):
        blocks.append(block)
        size -= len(block)
    return blocks


def ask(uri: str, method: str, arguments: tuple[Any, ...], deadline: float) -> Any:
    """Call another node by XML-RPC (its "slave API"); the value that it answers.

    Args:
        uri: of the node, as the master tells it.
        method: e.g. `requestTopic`.
        arguments: with the caller's name first.
        deadline: until when the answer has to be there, in seconds of `time.monotonic`.

    Raises:
        Broken: the answer is none, too long, or too late.
        OSError: the node cannot be reached.
    """
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise Broken("its address is no URI of a node") from error
    if not host or not port:
        raise Broken("its address is no URI of a node")
    body = xmlrpc.client.dumps(arguments, method).encode()
    head = f"POST {parts.path or '/'} HTTP/1.0\r\nHost: {host}:{port}\r\nContent-Type: text/xml\r\n"
    with socket.create_connection((host, port), max(deadline - time.monotonic(), 0.001)) as link:
        link.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        answer = _http_body(link, deadline)
    if has_declarations(answer):
        raise Broken("its answer to a call has declarations of XML, which no answer needs")
    try:
        answered: Any = xmlrpc.client.loads(answer)[0]
        ((code, text, value),) = answered
    except Exception as error:
        raise Broken(f"its answer to {method} is no answer ({type(error).__name__})") from error
    if code != 1:
        raise ConnectionRefusedError(f"it refused {method}: {str(text)[:200]}")
    return value


def has_declarations(text: bytes) -> bool:
    """Whether the parser of XML may find declarations there, and with them entities: no call or answer needs any.

    UTF-16, which it reads as well, has a NUL in each `<!`; all other encodings that it takes are ASCII there.
    """
    return b"<!" in text or b"\0" in text


def _http_body(link: socket.socket, deadline: float) -> bytes:
    what = "its answer to a call"
    content = bytearray()
    while (end := content.find(b"\r\n\r\n")) < 0:
        content += _receive(link, _BLOCK, deadline, what)
        if len(content) > MOST_ANSWER_BYTES:
            raise Broken(f"its answer to a call is longer than {MOST_ANSWER_BYTES} bytes")
    length = _HTTP_LENGTH.search(content, 0, end + 2)
    if length is None or (size := int(length[1])) > MOST_ANSWER_BYTES:
        raise Broken("its answer to a call does not say how long it is, or is too long")
    if len(content) < end + 4 + size:
        content += _exactly(link, end + 4 + size - len(content), deadline, what)
    return bytes(content[end + 4 : end + 4 + size])


def is_there(uri: str, caller: str) -> bool:
    """Whether a node answers, or at least takes a connection, within a second."""
    try:
        ask(uri, "getPid", (caller,), time.monotonic() + 1.0)
    except Broken:
        return True
    except OSError:
        return False
    return True


def topic_address(uri: str, caller: str, topic: str, deadline: float) -> tuple[str, int]:
    """Host and port where a node publishes a topic; raises as `ask`."""
    answer = ask(uri, "requestTopic", (caller, topic, [["TCPROS"]]), deadline)
    try:
        protocol, host, port = answer
    except (TypeError, ValueError):
        protocol = host = port = None
    if protocol != "TCPROS" or not isinstance(host, str) or type(port) is not int or not 0 < port < 1 << 16:
        raise Broken("it publishes the topic by no way that is known here")
    return host, port
