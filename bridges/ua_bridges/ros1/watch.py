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

from ua_bridges.ros.feed import Feed, MirrorFeed
from ua_bridges.ros.names import UaNames
from ua_bridges.ros.served import Served
from ua_bridges.ros1.graph import unregistered
from ua_bridges.ros1.master import RosMaster, SystemState
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.node import RosNode
from ua_bridges.ros1.outlet import Outlet
from ua_bridges.ros1.source import RosSource
from ua_bridges.ros1.subscribers import Relinking
from ua_bridges.ros1.tcpros import is_there
from ua_fleet.bridge.driver import DriverStatus, Dropped, Inlet, SourceForgotten
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop
from ua_fleet.errors import NotConnected
from ua_fleet.printing import harmless
from ua_fleet.topics import Topic

__all__ = ["Watch"]

LOOK_PERIOD_S: Final = 0.1
"""A look costs the master about half a millisecond."""
QUIET_AFTER_S: Final = 10.0
QUIET_LOOK_PERIOD_S: Final = 0.5
"""Between looks at a graph in which nothing has changed for QUIET_AFTER_S."""
SHORTEST_PAUSE_S: Final = 0.02
"""Between two looks, however often somebody says that there is something new."""
MOST_SOURCES: Final = 2000
"""Topics of the own space that are listened to; anybody may make new ones."""
MOST_REGISTERED_AT_ONCE: Final = 50
"""In one look, a call to the master each, so that the other topics need not wait for a flood of them."""
FORGET_S: Final = 60.0
"""A topic of the own space that nobody publishes for so long is forgotten."""
ASK_S: Final = 1.0
"""While another node has the name of this one, the master is asked so often whether it is free."""
CLOSING_S: Final = 2.0
"""For the links to end."""
NOTE_PERIOD_S: Final = 1.0
"""So often it is looked who has a link, and noted who is served: a call to the master for each subscriber of a latched
topic."""

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
        offenders: Offenders,
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
            offenders: the publishers that are put aside.
        """
        self._node, self._master, self._inlet, self._loop = node, master, inlet, loop
        self._mapped, self._outlets, self._memory, self._served = mapped, outlets, memory, served
        self._spoken, self._offenders = spoken, offenders
        self._note_at = 0.0
        self._names = UaNames(space)
        self._sources: dict[str, RosSource] = {}
        self._unheard: dict[str, float] = {}
        """Since when nobody publishes a mirrored topic, or it is dead."""
        self._refused: list[str] = []
        """For which there was no room."""
        self._looked_at = self._changed_at = 0.0
        self._ask_at = 0.0
        self._suspects_eviction = False
        self._has_told_order = False
        self.is_evicted = False
        """Whether another node has the name of this one."""
        self._registered: set[tuple[str, str]] = set()
        """What this process has registered: ("publisher" or "subscriber", topic)."""
        self._stopping = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros1-watch", daemon=True)
        self._relinking = Relinking(node.name, inlet, node.doorman.is_refused, self._wake.set)
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
        self._close_links()
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
                self._listen(name, feeds)
            self._node.orders.told = self._wake.set
            while not self._stopping.is_set():
                if not self._node.is_reachable:
                    raise RuntimeError("the server of the ROS 1 node has ended")
                self._looked_at = time.monotonic()
                self._look()
                self._wake.wait(QUIET_LOOK_PERIOD_S if self._is_quiet() else LOOK_PERIOD_S)
                if (left := self._looked_at + SHORTEST_PAUSE_S - time.monotonic()) > 0:
                    self._stopping.wait(left)
                self._wake.clear()
        except Exception as error:  # noqa: BLE001 - nobody else would hear of it: `status` tells
            _log.exception("the watch of the ROS graph has ended", node=self._node.name)
            why = f"the watch of the ROS graph has ended by a mistake of the bridge ({error!r})"
            self.status = DriverStatus(False, f"{why}; report its log, and start it again", is_over=True)
            self._close_links()

    def _is_quiet(self) -> bool:
        """Whether nothing has changed for a while, and no source is about to be lost."""
        if self._looked_at < self._changed_at + QUIET_AFTER_S:
            return False
        return not any(source.is_missed for source in self._sources.values())

    def _listen(self, name: str, feeds: Sequence[Feed]) -> None:
        self._sources[name] = RosSource(name, feeds, self._node.name, self._inlet, self._memory, self._offenders)

    def _look(self) -> None:
        state: SystemState | None = None
        try:
            if self._look_for_eviction():
                return
            for name in self._node.orders.take_topics() & self._sources.keys():
                self._registered.discard(("subscriber", name))  # registering again tells the publishers' addresses
            for name in self._relinking.take_due():
                self._registered.discard(("publisher", name))  # registering again tells the subscribers of us
            state = self._master.system_state()
            if state != self.state:
                self._changed_at = self._looked_at
            self.state = state
            if self._has_lost(state):
                # Who takes a name takes its topics too, and the master tells of it later than it does so: to register
                # at once would be to take the name back.
                self._suspects_eviction = True
                if self._look_for_eviction():
                    return
            self._find(state)
            self._register(state)
            self._forget(state)
            self.status = DriverStatus(True, f"node {self._node.name} at the ROS master {self._master.uri}")
        except NotConnected as error:
            self.status = DriverStatus(False, str(error))
        self._check_sources(state)
        with contextlib.suppress(NotConnected):  # said at the next look
            self._check_outlets(state)
            self._look_after_subscribers(state)

    def _find(self, state: SystemState) -> None:
        if len(self._sources) < MOST_SOURCES or self._unheard:
            for name in self._refused:
                self._names.forget(name)
            self._refused.clear()
        news = self._names.look(state.publishers)
        for _, error in news.illegal:
            self._inlet.put(Dropped(Drop.ILLEGAL_TOPIC, detail=str(error)))
        for topic in news.found:
            name = f"/{topic.name}"
            if name in self._mapped:
                continue  # a robot's program tells of its executions there
            if len(self._sources) >= MOST_SOURCES and not self._make_room():
                self._inlet.put(Dropped(Drop.UNKNOWN_SOURCE, detail=f"more than {MOST_SOURCES} topics of this space"))
                self._refused.append(name)
                continue
            self._listen(name, [MirrorFeed(topic, self._inlet)])

    def _forget(self, state: SystemState) -> None:
        """Let go of the mirrored topics that nobody publishes any more."""
        now = time.monotonic()
        for name, source in list(self._sources.items()):
            if name in self._mapped:
                continue
            if source.is_alive:
                self._unheard.pop(name, None)
            elif now < self._unheard.setdefault(name, now) + FORGET_S:
                continue
            elif not state.publishers.get(name):
                self._drop(name)

    def _make_room(self) -> bool:
        """Let go of the mirrored topic that has been dead for the longest time; False where all are alive."""
        if not self._unheard:
            return False
        self._drop(min(self._unheard, key=lambda name: self._unheard[name]))
        return True

    def _drop(self, name: str) -> None:
        topic = Topic.parse(name[1:])
        self._unheard.pop(name, None)
        source = self._sources.pop(name)
        source.lose()
        source.close()
        self._names.forget(name)
        self._inlet.put(SourceForgotten(topic))
        if ("subscriber", name) in self._registered:
            self._registered.discard(("subscriber", name))
            with contextlib.suppress(NotConnected):  # said at the next look
                self._master.unregister((), [name], self._node.uri)

    def _register(self, state: SystemState) -> None:
        types = {**self._spoken, **{outlet.name: outlet.kind.name for outlet in self._outlets}}
        for name in self._due("publisher", types, state.publishers):
            self._master.register_publisher(name, types[name], self._node.uri)
            self._registered.add(("publisher", name))
        for name in self._due("subscriber", self._sources, state.subscribers)[:MOST_REGISTERED_AT_ONCE]:
            uris = self._master.register_subscriber(name, "*", self._node.uri)
            self._sources[name].connect(uris, time.monotonic())
            self._registered.add(("subscriber", name))

    def _has_lost(self, state: SystemState) -> bool:
        """Whether the master has forgotten anything that this process has registered."""
        known = {"publisher": state.publishers, "subscriber": state.subscribers}
        return any(self._node.name not in known[role].get(name, ()) for role, name in self._registered.copy())

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

    def _look_after_subscribers(self, state: SystemState | None) -> None:
        now = time.monotonic()
        if now < self._note_at:
            return
        self._note_at = now + NOTE_PERIOD_S
        for outlet in self._outlets:
            self._serve(outlet, state)
        if state is not None:
            published = [name for role, name in self._registered if role == "publisher"]
            self._relinking.look(published, state.subscribers, self._master.node_uri, now)

    def _lose_sources(self) -> None:
        for source in self._sources.values():
            source.lose()

    def _close_links(self) -> None:
        self._lose_sources()
        links = [link for source in self._sources.values() for link in source.close()]
        deadline = time.monotonic() + CLOSING_S
        for link in links:
            link.join(max(deadline - time.monotonic(), 0.0))

    def _look_for_eviction(self) -> bool:
        """Whether another node has the name of this one. Raises NotConnected.

        A call to end is a hint and no more, since anybody can make it: the master knows who has the name.
        """
        told = self._node.orders.take_shutdown() is not None
        self._suspects_eviction |= told
        now = time.monotonic()
        if not (self._suspects_eviction or self.is_evicted) or (self.is_evicted and now < self._ask_at):
            return self.is_evicted
        self._ask_at = now + ASK_S
        uri = self._master.node_uri(self._node.name)
        self._suspects_eviction = False
        if uri is not None and uri != self._node.uri and is_there(uri, self._node.name):
            self._evicted(uri)
        else:
            if uri != self._node.uri:
                self._registered.clear()
            if self.is_evicted:
                self._return()
            elif told and not self._has_told_order:
                self._has_told_order = True
                said = (
                    "the ROS master asked the bridge to shut down, and no other node has its name: the bridge goes on"
                )
                self._inlet.put(Dropped(Drop.MISBEHAVED, detail=said))
            elif told:
                self._inlet.put(Dropped(Drop.MISBEHAVED))
        return self.is_evicted

    def _evicted(self, uri: str) -> None:
        if not self.is_evicted:
            self.is_evicted = True
            self._close_links()
        self.status = DriverStatus(
            False,
            f"another node took the name {self._node.name} (its address is {harmless(uri)[:200]}); stop it, or give "
            "this bridge another `node_name`; the bridge comes back when the name is free",
        )

    def _return(self) -> None:
        self.is_evicted = False
        self._registered.clear()
        for source in self._sources.values():
            source.open_again()
