"""One TCPROS link from a publisher of a topic to the bridge, with a thread of its own. Not rospy's.

rospy believes what a publisher says: it takes the memory that a length asks for, waits a minute for a handshake, and
makes a link that failed anew by itself. Here a link is made once and ends once; who has it decides about the next.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from typing import Final, Protocol

import structlog

from ua_bridges.ros1.tcpros import Broken, keep_alive, read_header, read_message, topic_address, write_header

__all__ = ["Link", "LinkOwner"]

HANDSHAKE_S: Final = 5.0
"""From the first question to the publisher's connection header."""
_BUFFER_BYTES: Final = 1 << 20

_log = structlog.get_logger("ua_bridges.ros1")


class LinkOwner(Protocol):
    """Who reads a link. All three are called in the link's thread."""

    def link_up(self, link: Link) -> None:
        """The publisher's header has come. Broken and other errors end the link."""
        ...

    def link_heard(self, link: Link, content: bytes) -> None:
        """A message has come. Broken and other errors end the link."""
        ...

    def link_ended(self, link: Link, offence: str | None) -> None:
        """The link is over; what the publisher did that no publisher should, or None where it merely went."""
        ...


class Link:
    """A link to one publisher: its address, and its connection header once it has come."""

    def __init__(self, topic: str, uri: str, node_name: str, owner: LinkOwner) -> None:
        """Prepare a link; `start` makes it.

        Args:
            topic: full name.
            uri: of the publisher's node.
            node_name: of this node.
            owner: reads it.
        """
        self.topic, self.uri = topic, uri
        self.header: dict[str, str] = {}
        self._node_name, self._owner = node_name, owner
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name=f"ros1 {topic}", daemon=True)

    def start(self) -> None:
        """Begin; returns at once."""
        self._thread.start()

    def close(self) -> None:
        """End the link; its thread ends soon. Callable from any thread."""
        with self._lock:
            self._is_closed = True
            if self._socket is not None:
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_RDWR)

    def join(self, timeout_s: float) -> None:
        """Wait for the end of a link that was closed."""
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        offence: str | None = None
        try:
            self._read()
        except Broken as error:
            offence = str(error)
        except OSError:
            pass  # it went, or is not there: the watch looks again
        except Exception as error:  # noqa: BLE001 - whatever a publisher makes us do wrong costs this publisher
            _log.exception("a link of ROS 1 ended by a mistake of the bridge", topic=self.topic, publisher=self.uri)
            offence = f"what it sent led to a mistake of the bridge ({type(error).__name__}); report the log"
        if self._is_closed:
            offence = None
        self._owner.link_ended(self, offence)

    def _read(self) -> None:
        deadline = time.monotonic() + HANDSHAKE_S
        address = topic_address(self.uri, self._node_name, self.topic, deadline)
        with socket.create_connection(address, max(deadline - time.monotonic(), 0.001)) as link:
            with self._lock:
                if self._is_closed:
                    return
                self._socket = link
            try:
                self._handshake(link, deadline)
                with link.makefile("rb", buffering=_BUFFER_BYTES) as stream:
                    while True:
                        self._owner.link_heard(self, read_message(stream))
            finally:
                with self._lock:
                    self._socket = None

    def _handshake(self, link: socket.socket, deadline: float) -> None:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        keep_alive(link)
        asked = {"topic": self.topic, "type": "*", "md5sum": "*", "callerid": self._node_name, "tcp_nodelay": "1"}
        write_header(link, asked, deadline)
        header = read_header(link, deadline)
        if "error" in header:
            raise ConnectionRefusedError(header["error"][:200])
        for name in ("type", "md5sum"):
            if name not in header:
                raise Broken(f"its connection header has no `{name}`")
        link.settimeout(None)
        self.header = header
        self._owner.link_up(self)
