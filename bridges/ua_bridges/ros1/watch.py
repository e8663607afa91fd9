# pyright: basic, reportMissingImports=false
"""The thread that watches the ROS 1 graph.

It looks at the master several times a second, since ROS 1 tells nobody about new topics, and it is the only one that
talks to the master, so that nothing else ever waits for it. Links between nodes do not need the master: what is
linked goes on while it is away.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import structlog

from ua_bridges.ros.served import Served
from ua_bridges.ros1.feed import Feed, MirrorFeed
from ua_bridges.ros1.graph import GraphWatch, unregistered
from ua_bridges.ros1.master import RosMaster, SystemState
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.node import RosNode
from ua_bridges.ros1.outlet import Outlet
from ua_bridges.ros1.source import RosSource
from ua_fleet.bridge.driver import DriverStatus, Dropped, Inlet
from ua_fleet.counters import Drop
from ua_fleet.errors import NotConnected

__all__ = ["Watch"]

LOOK_PERIOD_S: Final = 0.1
"""A look costs the master about half a millisecond."""
NOTE_PERIOD_S: Final = 1.0
"""So often it is noted who is served: a call to the master for each subscriber of a latched topic."""

_log = structlog.get_logger("ua_bridges.ros1")


class Watch:
    """Finds topics, keeps the node registered, and says which sources are alive."""

    def __init__(
        self,
        space: int,
        node: RosNode,
        master: RosMaster,
        inlet: Inlet,
        loop: asyncio.AbstractEventLoop,
        mapped: Mapping[str, Sequence[Feed]],
        outlets: Iterable[Outlet],
        memory: LatchMemory,
        served: Served,
        spoken: Mapping[str, str],
    ) -> None:
        """Prepare the watch.

        Args:
            space: the own one.
            node: this process in the graph.
            master: for the watch alone.
            inlet: where sources are told.
            loop: the outlets' event loop.
            mapped: who reads robots' own topics, by the topic's name with its slash.
            outlets: what the bridge publishes.
            memory: of latched sources.
            served: whom the bridge before this one had served.
            spoken: type of each topic that skills publish.
        """
        self._node, self._master, self._inlet, self._loop = node, master, inlet, loop
        self._mapped, self._outlets, self._memory, self._served = mapped, outlets, memory, served
        self._spoken = spoken
        self._note_at = 0.0
        self._graph = GraphWatch(space)
        self._sources: dict[str, RosSource] = {}
        self._registered: set[tuple[str, str]] = set()
        """What this process has registered: ("publisher" or "subscriber", topic)."""
        self._stopping = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros1-watch", daemon=True)
        self.status = DriverStatus(False, f"looking for the ROS master at {master.uri}")
        self.state = SystemState({}, {}, {})
        """What the master said last."""

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def outlets_changed(self, replaced: Outlet | None = None) -> None:
        """Register what is new without waiting for the next look. Callable from any thread."""
        if replaced is not None:
            self._registered.discard(("publisher", replaced.name))
        self._wake.set()

    def leave(self) -> None:
        """Stop looking, and sign off from the master. Blocks for some 10 ms, at most for a call to the master."""
        self._stopping.set()
        self._wake.set()
        self._thread.join()
        registered = self._registered
        with contextlib.suppress(NotConnected):  # without a master there is nobody to sign off from
            self._master.unregister(
                [name for role, name in registered if role == "publisher"],
                [name for role, name in registered if role == "subscriber"],
                self._node.uri,
            )
        self._master.close()
        self.status = DriverStatus(False, "stopped")

    def _run(self) -> None:
        try:
            for name, feeds in self._mapped.items():
                self._sources[name] = RosSource(name, feeds, self._node, self._inlet, self._memory)
            while not self._stopping.is_set():
                if self._node.was_shut_down:
                    self._evicted()
                    return
                if not self._node.is_reachable:
                    raise RuntimeError("the server of the ROS 1 node has ended")
                self._look()
                self._wake.wait(LOOK_PERIOD_S)
                self._wake.clear()
        except Exception as error:  # noqa: BLE001 - nobody else would hear of it: `status` tells
            _log.exception("the watch of the ROS graph has ended", node=self._node.name)
            why = f"the watch of the ROS graph has ended by a mistake of the bridge ({error!r})"
            self.status = DriverStatus(False, f"{why}; report its log, and start it again", is_over=True)
            self._lose_sources()

    def _look(self) -> None:
        state: SystemState | None = None
        try:
            self.state = state = self._master.system_state()
            self._find(state)
            self._register(state)
            self.status = DriverStatus(True, f"node {self._node.name} at the ROS master {self._master.uri}")
        except NotConnected as error:
            self.status = DriverStatus(False, str(error))
        self._check_sources(state)
        with contextlib.suppress(NotConnected):  # said at the next look
            self._check_outlets(state)
            self._note_served(state)

    def _find(self, state: SystemState) -> None:
        news = self._graph.look(state.publishers)
        for error in news.illegal:
            self._inlet.put(Dropped(Drop.ILLEGAL_TOPIC, detail=str(error)))
        for topic in news.found:
            name = f"/{topic.name}"
            if name in self._mapped:
                continue  # a robot's program tells of its executions there
            self._sources[name] = RosSource(
                name, [MirrorFeed(topic, self._inlet)], self._node, self._inlet, self._memory
            )

    def _register(self, state: SystemState) -> None:
        types = {**self._spoken, **{outlet.name: outlet.kind.name for outlet in self._outlets}}
        for name in self._due("publisher", types, state.publishers):
            self._master.register_publisher(name, types[name], self._node.uri)
            self._registered.add(("publisher", name))
        for name in self._due("subscriber", self._sources, state.subscribers):
            self._node.connect(name, self._master.register_subscriber(name, "*", self._node.uri))
            self._registered.add(("subscriber", name))

    def _due(self, role: str, wanted: Mapping[str, Any], known: Mapping[str, list[str]]) -> list[str]:
        # A bridge that was killed may still stand in the master under our name, with a dead address: what this
        # process has not registered itself is due whatever the master says.
        forgotten = set(unregistered(wanted, known, self._node.name))
        return [name for name in wanted if name in forgotten or (role, name) not in self._registered]

    def _check_sources(self, state: SystemState | None) -> None:
        now = time.monotonic()
        for name, source in self._sources.items():
            publishers = None if state is None else state.publishers.get(name, ())
            if source.check(publishers, now):
                self._registered.discard(("subscriber", name))  # registering again tells the publishers' addresses

    def _check_outlets(self, state: SystemState | None) -> None:
        for outlet in self._outlets:
            if outlet.is_open:
                continue
            subscribers = None
            if state is not None and ("publisher", outlet.name) in self._registered:
                subscribers = len(self._subscribers(outlet, state))
            if outlet.is_ready(subscribers):
                self._loop.call_soon_threadsafe(outlet.open, self._serve(outlet, state))

    def _subscribers(self, outlet: Outlet, state: SystemState) -> list[str]:
        return [name for name in state.subscribers.get(outlet.name, ()) if name != self._node.name]

    def _serve(self, outlet: Outlet, state: SystemState | None) -> frozenset[str]:
        """Note whom a latched topic serves; the names of those that the bridge before this one had not served."""
        if state is None or not outlet.is_latched:
            return frozenset()
        owed: set[str] = set()
        for name in self._subscribers(outlet, state):
            subscriber = f"{outlet.name} {self._master.node_uri(name)}".encode()  # a restarted node has another address
            if not self._served.before(subscriber):
                owed.add(name)
            self._served.note(subscriber)
        return frozenset(owed)

    def _note_served(self, state: SystemState | None) -> None:
        now = time.monotonic()
        if now >= self._note_at:
            self._note_at = now + NOTE_PERIOD_S
            for outlet in self._outlets:
                self._serve(outlet, state)

    def _lose_sources(self) -> None:
        for source in self._sources.values():
            source.lose()

    def _evicted(self) -> None:
        """Not over: a bridge that started anew would take the name back, and two that do so never end."""
        self._lose_sources()
        self.status = DriverStatus(
            False,
            f"another node took the name {self._node.name}, or somebody ended it; stop the other one and restart this "
            "bridge",
        )
