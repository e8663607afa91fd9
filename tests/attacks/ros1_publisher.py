"""A publisher in a ROS 1 graph that is made of plain sockets, so that it can do what rospy would not."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Mapping
from typing import Any, Self
from xmlrpc.server import SimpleXMLRPCServer

Serve = Callable[[socket.socket], None]
"""Speaks to one subscriber: its header has been read. The link is closed when it returns, or fails."""

FLOAT = {
    "type": "std_msgs/Float64",
    "md5sum": "fdb28210bfa9d7c91146260178d9a584",
    "message_definition": "float64 data\n",
}


def header(fields: Mapping[str, str] = FLOAT, **more: str) -> bytes:
    """A connection header."""
    pairs = [f"{name}={value}".encode() for name, value in {"callerid": "/hostile", **fields, **more}.items()]
    content = b"".join(struct.pack("<I", len(pair)) + pair for pair in pairs)
    return struct.pack("<I", len(content)) + content


def message(content: bytes) -> bytes:
    """A message as it stands on a link."""
    return struct.pack("<I", len(content)) + content


def made_of(definition: str, **more: str) -> bytes:
    """The header of a type that nobody has installed."""
    return header({"type": "acme_msgs/Thing", "md5sum": "0" * 32, "message_definition": definition}, **more)


def say(*parts: bytes) -> Serve:
    """Say that, and stay until the subscriber goes."""

    def serve(link: socket.socket) -> None:
        for part in parts:
            link.sendall(part)
        while link.recv(1 << 16):
            pass

    return serve


def endless(*parts: bytes, again: bytes, pause_s: float = 0.0) -> Serve:
    """Say that, and the last of it for ever."""

    def serve(link: socket.socket) -> None:
        for part in parts:
            link.sendall(part)
        while True:
            link.sendall(again)
            time.sleep(pause_s)

    return serve


def silent(link: socket.socket) -> None:
    """Say nothing."""
    while link.recv(1 << 16):
        pass


class HostilePublisher:
    """One node with one topic; each link to it is a thread."""

    def __init__(self, master_uri: str, topic: str, serve: Serve, name: str = "/hostile") -> None:
        self.topic, self.name, self.serve = topic, name, serve
        self.links = 0
        """Links so far."""
        self.asked = 0
        """How often somebody asked where to connect to."""
        self._master_uri = master_uri
        self._open: list[socket.socket] = []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.api = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
        self.api.register_function(self._request_topic, "requestTopic")
        self.api.register_function(self._take_update, "publisherUpdate")
        self.uri = f"http://127.0.0.1:{self.api.server_address[1]}/"

    def _request_topic(self, *_: Any) -> list[Any]:
        self.asked += 1
        return [1, "", ["TCPROS", "127.0.0.1", self.listener.getsockname()[1]]]

    def _take_update(self, *_: Any) -> list[Any]:
        return [1, "", 0]

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                link, _ = self.listener.accept()
                self.links += 1
                self._open.append(link)
                threading.Thread(target=self._meet, args=(link,), daemon=True).start()

    def _meet(self, link: socket.socket) -> None:
        with link, contextlib.suppress(OSError):
            link.recv(1 << 20)
            self.serve(link)

    def call_master(self, method: str, *args: str) -> Any:
        """Call the master in the name of this node."""
        with xmlrpc.client.ServerProxy(self._master_uri) as master:
            return getattr(master, method)(self.name, *args)

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        threading.Thread(target=self.api.serve_forever, daemon=True).start()
        self.call_master("registerPublisher", self.topic, "std_msgs/Float64", self.uri)
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self.call_master("unregisterPublisher", self.topic, self.uri)
        self.api.shutdown()
        self.api.server_close()
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        for link in self._open:
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
