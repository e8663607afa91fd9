"""The ROS 1 master over XML-RPC, with a timeout on every call (rospy's own proxy has none)."""

from __future__ import annotations

import http.client
import xmlrpc.client
from collections.abc import Iterable
from typing import Any, Final, NamedTuple
from xml.parsers.expat import ExpatError

from ua_fleet.errors import NotConnected

__all__ = ["RosMaster", "SystemState"]

CALL_TIMEOUT_S: Final = 2.0
"""A master on the local network answers within milliseconds; one that takes longer counts as absent."""


class SystemState(NamedTuple):
    """What the master knows: the names of the nodes that publish, subscribe to, or serve each name."""

    publishers: dict[str, list[str]]
    subscribers: dict[str, list[str]]
    services: dict[str, list[str]]


class _Transport(xmlrpc.client.Transport):
    """Parses an answer only where it is another one than the last: ten times a second the graph is what it was."""

    accept_gzip_encoding = False
    """To pack and unpack costs more than to send, on the machine of the master too."""

    def __init__(self) -> None:
        super().__init__()
        self._last: tuple[bytes, Any] = (b"", None)

    def parse_response(self, response: Any) -> Any:
        """The values in an answer, which nobody may change."""
        body: bytes = response.read()
        if body != self._last[0]:
            parser, unmarshaller = self.getparser()
            parser.feed(body)
            parser.close()
            self._last = body, unmarshaller.close()
        return self._last[1]

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = CALL_TIMEOUT_S
        return connection


class RosMaster:
    """Calls the master in the name of one node. Not for use by several threads at the same time."""

    def __init__(self, uri: str, node_name: str) -> None:
        self.uri = uri
        self._node_name = node_name
        self._transport = _Transport()
        self._proxy = xmlrpc.client.ServerProxy(uri, transport=self._transport)

    def _ask(self, method: str, *args: str) -> tuple[int, str, Any]:
        try:
            answer: Any = getattr(self._proxy, method)(self._node_name, *args)
            code, text, value = answer
        except (OSError, http.client.HTTPException, xmlrpc.client.Error, ExpatError, TypeError, ValueError) as error:
            self._transport.close()
            raise NotConnected(
                f"no ROS master at {self.uri} ({error}); start roscore there, or correct `master_uri`"
            ) from error
        return code, text, value

    def _call(self, method: str, *args: str) -> Any:
        code, text, value = self._ask(method, *args)
        if code != 1:
            raise NotConnected(f"the ROS master at {self.uri} refused {method}: {text}")
        return value

    def system_state(self) -> SystemState:
        """Who publishes, subscribes to and serves what. This and all other calls raise NotConnected."""
        answer = self._call("getSystemState")
        try:
            publishers, subscribers, services = answer
            return SystemState(dict(publishers), dict(subscribers), dict(services))
        except (TypeError, ValueError) as error:
            raise NotConnected(f"what answers at {self.uri} is no ROS master; correct `master_uri`") from error

    def topic_types(self) -> dict[str, str]:
        """The type of each topic that somebody has registered with one."""
        answer = self._call("getTopicTypes")
        try:
            return {str(topic): str(kind) for topic, kind in answer}
        except (TypeError, ValueError) as error:
            raise NotConnected(f"what answers at {self.uri} is no ROS master; correct `master_uri`") from error

    def register_publisher(self, topic: str, message_type: str, node_uri: str) -> None:
        """Make the node a publisher of the topic; the master tells its subscribers. May be repeated."""
        self._call("registerPublisher", topic, message_type, node_uri)

    def register_subscriber(self, topic: str, message_type: str, node_uri: str) -> list[str]:
        """Make the node a subscriber of the topic; the addresses of its publishers. May be repeated."""
        return list(self._call("registerSubscriber", topic, message_type, node_uri))

    def node_uri(self, name: str) -> str | None:
        """The address of a node's process; None when the master does not know the node."""
        code, _, uri = self._ask("lookupNode", name)
        return str(uri) if code == 1 else None

    def service_uri(self, name: str) -> str | None:
        """The address of a service, `rosrpc://host:port`; None when nobody offers it."""
        code, _, uri = self._ask("lookupService", name)
        return str(uri) if code == 1 else None

    def unregister(self, publications: Iterable[str], subscriptions: Iterable[str], node_uri: str) -> None:
        """Take back registrations, in one call."""
        calls = [("unregisterPublisher", topic) for topic in publications]
        calls += [("unregisterSubscriber", topic) for topic in subscriptions]
        multi = xmlrpc.client.MultiCall(self._proxy)
        for method, topic in calls:
            getattr(multi, method)(self._node_name, topic, node_uri)
        try:
            if calls:
                multi()
        except (OSError, http.client.HTTPException, xmlrpc.client.Error, ExpatError) as error:
            raise NotConnected(f"no ROS master at {self.uri} ({error})") from error

    def close(self) -> None:
        """Close the connection that is kept between calls."""
        self._transport.close()
