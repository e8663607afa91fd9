"""A ROS 1 graph for one test: a real rosmaster, stock nodes, and the bridge, each a process of its own."""

from __future__ import annotations

import asyncio
import json
import time
import xmlrpc.client
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

from tests import system
from ua_fleet.counters import Counters
from ua_fleet.pubsub.events import (
    DataReceived,
    ProbeReceived,
    SourceReturned,
    SourceSilent,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData

HERE = Path(__file__).parent
STATUS = Topic(1, 2, 900)
WAIT_S = 15.0


class Ros1Graph:
    """The processes of a test."""

    def __init__(self, processes: system.Processes, folder: Path, pubsub_url: str) -> None:
        self.processes, self.folder, self.pubsub_url = processes, folder, pubsub_url
        self.port = system.free_tcp_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self.env = system.clean_environment(
            ROS_MASTER_URI=self.uri, ROS_IP="127.0.0.1", ROS_LOG_DIR=str(folder / "log"), HOME=str(folder)
        )

    def master(self) -> system.Child:
        """Start the master; ready when it answers."""
        child = self.processes.start("/usr/bin/rosmaster", "--core", "-p", str(self.port), "-w", "3", env=self.env)
        deadline = time.monotonic() + WAIT_S
        while True:
            try:
                self.state()
            except OSError:
                if time.monotonic() > deadline or child.process.poll() is not None:
                    raise
                time.sleep(0.02)
            else:
                return child

    def node(self, script: str, *args: str, ready: bool = True) -> system.Child:
        """Start a stock node."""
        child = self.processes.start(system.ROS1_PYTHON, HERE / "nodes" / script, *args, env=self.env)
        if ready:
            child.wait_for("ready")
        return child

    def talker(self, topic: str, type_: str, yaml: str, *args: str, ready: bool = True) -> system.Child:
        return self.node("talker.py", topic, type_, yaml, *args, ready=ready)

    def listener(self, topic: str, type_: str, *args: str) -> system.Child:
        return self.node("listener.py", topic, type_, *args)

    def bridge(self, robots: Mapping[str, Any] | None = None, **pubsub: Any) -> system.Child:
        """Start the bridge of space 1."""
        config = {
            "version": 1,
            "pubsub": {"security": "none", "url": self.pubsub_url, **pubsub},
            "bridges": {"ros1": {"kind": "ros1", "space": 1, "master_uri": self.uri, "status_id": STATUS.id}},
            "robots": robots or {},
        }
        path = self.folder / "fleet.json"
        path.write_text(json.dumps(config))
        child = self.processes.start(system.ROS1_PYTHON, HERE / "run_bridge.py", path, "ros1", env=self.env)
        child.wait_for("ready")
        return child

    def state(self) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
        """The publishers and the subscribers of each topic, as the master knows them."""
        with xmlrpc.client.ServerProxy(self.uri) as master:
            answer: Any = master.getSystemState("/test")
        _, _, (publishers, subscribers, _) = answer
        return dict(publishers), dict(subscribers)


class Heard(NamedTuple):
    """What came over PubSub, with the time of its arrival (seconds, monotonic)."""

    at: float
    event: SubscriberEvent


class Peer:
    """Another member of the PubSub connection: the server (space 0) or another bridge."""

    def __init__(self, url: str, space: int = 2) -> None:
        timing, codec = PubSubTiming(), Codec()
        self.counters = Counters()
        self.space = space
        self.heard: list[Heard] = []
        self._subscriber = Subscriber(space, timing, self.counters, codec)
        self._publisher = Publisher(space, timing, self.counters, codec)
        self._transport = UdpTransport(url, "lo", ttl=1, receive_buffer_bytes=1 << 20)
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None

    async def __aenter__(self) -> Self:
        await self._transport.start(lambda datagram, _: self._receive(datagram))
        self._poll()
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._timer is not None:
            self._timer.cancel()
        await self._transport.close()

    def _receive(self, datagram: bytes) -> None:
        now = self._loop.time()
        for event in self._subscriber.receive(datagram, now):
            self._take(event, now)

    def _take(self, event: SubscriberEvent, now: float) -> None:
        self.heard.append(Heard(now, event))
        if isinstance(event, SourceUnknown):
            self._transport.send(event.datagram)
        elif isinstance(event, ProbeReceived):
            for datagram in self._publisher.answer(event.probe, now):
                self._transport.send(datagram)

    def _poll(self) -> None:
        now = self._loop.time()
        for event in self._subscriber.poll(now):
            self._take(event, now)
        for datagram in self._publisher.poll(now):
            self._transport.send(datagram)
        self._timer = self._loop.call_later(0.02, self._poll)

    def announce(self, topic: Topic, fields: tuple[FieldMetaData, ...]) -> None:
        for datagram in self._publisher.announce(
            topic, topic.name, fields, now=self._loop.time(), wall_ticks=self._wall()
        ):
            self._transport.send(datagram)

    def publish(self, topic: Topic, *values: Any) -> None:
        for datagram in self._publisher.publish(topic, values, timestamp=self._wall(), now=self._loop.time()):
            self._transport.send(datagram)

    def _wall(self) -> int:
        return ticks_from_unix_ns(time.time_ns())

    def data(self, topic: Topic) -> list[DataReceived]:
        return [
            heard.event for heard in self.heard if isinstance(heard.event, DataReceived) and heard.event.topic == topic
        ]

    def good(self, topic: Topic) -> list[DataSetMessage]:
        return [data.message for data in self.data(topic) if not data.message.status]

    def values(self, topic: Topic) -> list[tuple[Any, ...]]:
        return [message.values for message in self.good(topic)]

    def silent(self, topic: Topic) -> bool:
        """Whether the source is silent, or said that it is gone."""
        for heard in reversed(self.heard):
            event = heard.event
            if isinstance(event, DataReceived | SourceReturned | SourceSilent) and event.topic == topic:
                return isinstance(event, SourceSilent) or (
                    isinstance(event, DataReceived) and bool((event.message.status or 0) >> 31)
                )
        return False

    def status(self, field: str) -> Any:
        """A field of the bridge's own status, None before the first one."""
        seen = self.data(STATUS)
        if not seen:
            return None
        names = [each.name for each in seen[-1].metadata.fields]
        return seen[-1].message.values[names.index(field)]

    async def until(self, condition: Callable[[], Any], timeout_s: float = WAIT_S) -> float:
        """Wait for the condition; how long it took."""
        started = self._loop.time()
        while not condition():
            if self._loop.time() > started + timeout_s:
                tail = "\n".join(str(heard.event)[:300] for heard in self.heard[-20:])
                raise AssertionError(f"it did not come within {timeout_s} s; the last events:\n{tail}")
            await asyncio.sleep(0.01)
        return self._loop.time() - started

    async def stays(self, condition: Callable[[], Any], seconds: float) -> None:
        """The condition holds all the time."""
        end = self._loop.time() + seconds
        while self._loop.time() < end:
            assert condition()
            await asyncio.sleep(0.01)
