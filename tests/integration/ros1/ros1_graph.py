"""A ROS 1 graph for one test: a real rosmaster, stock nodes, and the bridge, each a process of its own."""

from __future__ import annotations

import asyncio
import json
import time
import xmlrpc.client
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tests import system
from tests.integration import peer
from tests.network import Cable
from ua_fleet.pubsub.events import DataReceived, SourceReturned, SourceSilent
from ua_fleet.topics import Topic

HERE = Path(__file__).parent
STATUS = Topic(1, 2, 900)
WAIT_S = 60.0


class Ros1Graph:
    """The processes of a test."""

    def __init__(self, processes: system.Processes, folder: Path, pubsub_url: str, cable: Cable | None = None) -> None:
        """With a cable, the master and all nodes are at its far end, and the bridge is at the near one."""
        self.processes, self.folder, self.pubsub_url = processes, folder, pubsub_url
        self.port = system.free_tcp_port()
        self._prefix: tuple[str, ...] = () if cable is None else cable.prefix
        self._bridge_ip, robot_ip = ("127.0.0.1", "127.0.0.1") if cable is None else (cable.near, cable.far)
        self.uri = f"http://{robot_ip}:{self.port}"
        self.env = system.clean_environment(
            ROS_MASTER_URI=self.uri,
            ROS_IP=robot_ip,
            ROS_LOG_DIR=str(folder / "log"),
            HOME=str(folder),
            UA_FLEET_RUNTIME_DIR=str(folder),
        )

    def master(self) -> system.Child:
        """Start the master; ready when it answers."""
        command = ("/usr/bin/rosmaster", "--core", "-p", str(self.port), "-w", "3")
        child = self.processes.start(*self._prefix, *command, env=self.env)
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
        node = HERE / "nodes" / script
        child = self.processes.start(*self._prefix, system.ROS1_PYTHON, node, *args, env=self.env)
        if ready:
            child.wait_for("ready")
        return child

    def talker(self, topic: str, type_: str, yaml: str, *args: str, ready: bool = True) -> system.Child:
        return self.node("talker.py", topic, type_, yaml, *args, ready=ready)

    def listener(self, topic: str, type_: str, *args: str) -> system.Child:
        return self.node("listener.py", topic, type_, *args)

    def bridge(self, robots: Mapping[str, Any] | None = None, **pubsub: Any) -> system.Child:
        """Start the bridge of space 1."""
        ends = {"master_uri": self.uri, "host_ip": self._bridge_ip}
        config = {
            "version": 1,
            "pubsub": {"security": "none", "url": self.pubsub_url, **pubsub},
            "bridges": {"ros1": {"kind": "ros1", "space": 1, "status_id": STATUS.id, **ends}},
            "robots": robots or {},
        }
        path = self.folder / "fleet.json"
        path.write_text(json.dumps(config))
        child = self.processes.start(system.ROS1_PYTHON, HERE.parent / "run_bridge.py", path, "ros1", env=self.env)
        child.wait_for("ready")
        return child

    def state(self) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
        """The publishers and the subscribers of each topic, as the master knows them."""
        publishers, subscribers, _ = self._known()
        return publishers, subscribers

    def services(self) -> dict[str, list[str]]:
        """Who serves each service, as the master knows it."""
        return self._known()[2]

    def uri_of(self, node: str) -> str:
        """The address of a node, as the master knows it."""
        with xmlrpc.client.ServerProxy(self.uri) as master:
            answer: Any = master.lookupNode("/test", node)
        return str(answer[2])

    async def linked(self, listener: system.Child, topic: str) -> None:
        """Wait until a listener has its link to the bridge, and the bridge knows it.

        rospy answers a subscriber before it counts the link: what it publishes between the two does not get there.
        """
        await asyncio.to_thread(listener.wait_for, "links 1")
        async with asyncio.timeout(WAIT_S):
            while topic not in await asyncio.to_thread(self._served_by_bridge):
                await asyncio.sleep(0.02)

    def _served_by_bridge(self) -> set[str]:
        """Topics for which it has a link to somebody else: of one mapped in both directions it has its own, too."""
        return {link[4] for link in self._links_from("/ua_bridge") if link[1] != "/ua_bridge"}

    def links(self, node: str, topic: str) -> set[int]:
        """The links from a node to the subscribers of a topic, by their numbers."""
        return {link[0] for link in self._links_from(node) if link[4] == topic}

    def _links_from(self, node: str) -> list[Any]:
        with xmlrpc.client.ServerProxy(self.uri_of(node)) as proxy:
            answer: Any = proxy.getBusInfo("/test")
        return [link for link in answer[2] if link[2] == "o"]

    def _known(self) -> tuple[dict[str, list[str]], ...]:
        with xmlrpc.client.ServerProxy(self.uri) as master:
            answer: Any = master.getSystemState("/test")
        _, _, parts = answer
        return tuple(dict(part) for part in parts)


class Peer(peer.Peer):
    """Another member of the PubSub connection, with what these tests ask of it."""

    def data(self, topic: Topic) -> list[DataReceived]:
        """All that was received of a source, with its metadata."""
        return [event for event in self.events if isinstance(event, DataReceived) and event.topic == topic]

    def silent(self, topic: Topic) -> bool:
        """Whether the source is silent, or said that it is gone."""
        for event in reversed(self.events):
            if isinstance(event, DataReceived | SourceReturned | SourceSilent) and event.topic == topic:
                return isinstance(event, SourceSilent) or (
                    isinstance(event, DataReceived) and bool((event.message.status or 0) >> 31)
                )
        return False

    def bridge(self, field: str) -> Any:
        """A field of the bridge's own status, None before the first one."""
        seen = self.data(STATUS)
        if not seen:
            return None
        names = [each.name for each in seen[-1].metadata.fields]
        return seen[-1].message.values[names.index(field)]

    async def takes(self, condition: Callable[[], Any]) -> float:
        """Wait for the condition; how long it took."""
        started = time.monotonic()
        await self.until(condition)
        return time.monotonic() - started

    async def stays(self, condition: Callable[[], Any], seconds: float) -> None:
        """The condition holds all the time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            assert condition()
            await asyncio.sleep(0.01)
