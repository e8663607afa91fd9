# pyright: basic, reportMissingImports=false
"""What other nodes of a ROS 1 graph may ask of this one: its slave API (XML-RPC), and its TCPROS port.

ROS 1 has no way to know who calls: a name in a call is a claim. So nothing that somebody says here is done: a
`publisherUpdate` has the bridge ask its master who publishes, and a `shutdown` has it ask whether another node took
its name. Who says nothing, or too much, loses the connection, and never the place of another.
"""

from __future__ import annotations

import contextlib
import resource
import socket
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Final

import rosgraph.network
import rosgraph.xmlrpc
import rospy.impl.masterslave
import structlog

from ua_bridges.ros1.tcpros import Broken, has_declarations, outlast, read_header, write_header

__all__ = ["ApiNode", "Doorman", "Orders", "SlaveApi"]

REQUEST_S: Final = 5.0
"""Between two calls of one connection, and for each read of a call."""
HANDSHAKE_S: Final = 5.0
"""For the connection header of a subscriber."""
MOST_WAITING: Final = 64
"""Connections that have not said what they want; then the oldest goes."""
MOST_REFUSED: Final = 1000
"""Subscribers that were refused, to be remembered."""
MOST_CALL_BYTES: Final = 1 << 20
"""Of one call: a list of 10,000 publishers."""
_log = structlog.get_logger("ua_bridges.ros1")

_SPARE_FILES: Final = 0.8
"""Above this part of the file descriptors that the process may have, nobody new is let in."""


def _is_full(link: socket.socket) -> bool:
    """Whether the process has almost as many files open as it may: the kernel gives the least free number."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return link.fileno() > soft * _SPARE_FILES


class _Waiting:
    """The connections from which nothing has come yet; when there are too many, the oldest goes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._links: OrderedDict[socket.socket, None] = OrderedDict()

    def add(self, link: socket.socket) -> bool:
        """Let a connection in, perhaps in the place of another; False where there is no room at all."""
        if _is_full(link):
            return False
        with self._lock:
            oldest = self._links.popitem(last=False)[0] if len(self._links) >= MOST_WAITING else None
            self._links[link] = None
        if oldest is not None:
            with contextlib.suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)
        return True

    def remove(self, link: socket.socket) -> None:
        """A connection has said what it wants, or is over."""
        with self._lock:
            self._links.pop(link, None)


class Orders:
    """What others have told this node to do; the watch finds out whether it is true."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._topics: set[str] = set()
        self._shutdown_of: str | None = None
        self.told: Callable[[], object] = lambda: None
        """Called in the thread of a call when there is something new."""

    def publishers_changed(self, topic: str) -> None:
        """Somebody says that a topic has other publishers than before."""
        with self._lock:
            if len(self._topics) < MOST_CALL_BYTES:
                self._topics.add(topic)
        self.told()

    def shut_down(self, caller: str) -> None:
        """Somebody says that this node is to end."""
        with self._lock:
            self._shutdown_of = caller[:200]
        self.told()

    def take_topics(self) -> set[str]:
        """The topics since the last time."""
        with self._lock:
            topics, self._topics = self._topics, set()
            return topics

    def take_shutdown(self) -> str | None:
        """Who has said since the last time that this node is to end; None where nobody has."""
        with self._lock:
            caller, self._shutdown_of = self._shutdown_of, None
            return caller


class SlaveApi(rospy.impl.masterslave.ROSHandler):  # type: ignore[misc]
    """rospy's slave API, which gives no orders."""

    def __init__(self, name: str, master_uri: str, orders: Orders) -> None:
        super().__init__(name, master_uri)
        self._orders = orders

    def shutdown(self, caller_id: Any, msg: Any = "") -> tuple[int, str, int]:
        """See Orders."""
        self._orders.shut_down(str(caller_id))
        return 1, "the master will be asked", 0

    def publisherUpdate(self, caller_id: Any, topic: Any, publishers: Any) -> tuple[int, str, int]:  # noqa: N802
        """See Orders."""
        self._orders.publishers_changed(str(topic)[:1000])
        return 1, "", 0

    def paramUpdate(self, caller_id: Any, parameter_key: Any, parameter_value: Any) -> tuple[int, str, int]:  # noqa: N802
        """The bridge has subscribed to no parameter."""
        return -1, "not subscribed", 0


class _RequestHandler(rosgraph.xmlrpc.SilenceableXMLRPCRequestHandler):  # type: ignore[misc]
    timeout = REQUEST_S

    def do_POST(self) -> None:  # noqa: N802 - the library's name
        try:
            size = int(self.headers.get("content-length", ""))
        except ValueError:
            size = -1
        if not 0 <= size <= MOST_CALL_BYTES:
            self.close_connection = True
            self.send_response(413)
            self.send_header("Content-length", "0")
            self.end_headers()
            return
        super().do_POST()

    def decode_request_content(self, data: bytes) -> bytes | None:
        decoded: bytes | None = super().decode_request_content(data)
        if decoded is None or not has_declarations(decoded):
            return decoded
        self.close_connection = True
        self.send_response(400, "a call needs no declarations of XML")
        self.send_header("Content-length", "0")
        self.end_headers()
        return None


class _Server(rosgraph.xmlrpc.ThreadingXMLRPCServer):  # type: ignore[misc]
    """A thread for each connection; never more than can be had."""

    def __init__(self, address: tuple[str, int]) -> None:
        super().__init__(address, 0)
        self.RequestHandlerClass = _RequestHandler
        self._waiting = _Waiting()
        self.begun = threading.Event()
        """Set once it serves, or is about to."""

    def serve_forever(self, poll_interval: float = 0.5) -> None:
        self.begun.set()
        super().serve_forever(poll_interval)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        return self._waiting.add(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._waiting.remove(request)


class ApiNode(rosgraph.xmlrpc.XmlRpcNode):  # type: ignore[misc]
    """The server of a slave API."""

    def _run_init(self) -> None:
        self.server = _Server((rosgraph.network.get_bind_address(), 0))
        self.port = self.server.server_address[1]
        host = rosgraph.network.get_address_override() or rosgraph.network.get_local_address()
        self.set_uri(f"http://{host}:{self.port}/")
        self.server.register_instance(self.handler)
        self.handler._ready(self.uri)  # noqa: SLF001 - how rosgraph does it


class Doorman:
    """Meets those who connect to the TCPROS port, each in a thread of its own; rospy meets one after the other."""

    def __init__(self, server: Any) -> None:
        """`server` is rospy's TCPROSServer, whose handlers take those who say what they want."""
        self._server = server
        self._waiting = _Waiting()
        self._lock = threading.Lock()
        self._refused: OrderedDict[tuple[str, str], None] = OrderedDict()

    def is_refused(self, topic: str, subscriber: str) -> bool:
        """Whether the link that a node has asked for last was refused, since it wants another type or so."""
        with self._lock:
            return (topic, subscriber) in self._refused

    def _note(self, header: Mapping[str, str], *, is_refused: bool) -> None:
        key = header.get("topic", ""), header.get("callerid", "")
        with self._lock:
            if not is_refused:
                self._refused.pop(key, None)
            else:
                self._refused[key] = None
                if len(self._refused) > MOST_REFUSED:
                    self._refused.popitem(last=False)

    def __call__(self, link: socket.socket, address: Any) -> None:
        """Meet a new connection; returns at once."""
        if self._waiting.add(link):
            threading.Thread(target=self._meet, args=(link, address), name="ros1-door", daemon=True).start()
        else:
            link.close()

    def _meet(self, link: socket.socket, address: Any) -> None:
        try:
            deadline = time.monotonic() + HANDSHAKE_S
            header = read_header(link, deadline)
            outlast(link)
            self._waiting.remove(link)
            link.settimeout(None)
            wanted = self._server.topic_connection_handler if "topic" in header else None
            refusal = wanted(link, address, header) if wanted is not None else "no topic is asked for"
            self._note(header, is_refused=bool(refusal))
            if refusal:
                write_header(link, {"error": str(refusal)}, deadline)
                link.close()
        except (Broken, OSError, ValueError):
            link.close()
        except Exception:  # noqa: BLE001 - whatever a subscriber makes us do wrong costs this subscriber
            _log.exception("a subscriber could not be met", node=str(address))
            link.close()
        finally:
            self._waiting.remove(link)
