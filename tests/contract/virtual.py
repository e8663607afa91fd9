"""A space in memory with its driver: the shortest one that keeps the contract."""

from __future__ import annotations

import asyncio
import logging
import queue
import threading
import time
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

from ua_bridges.ros import ros_type_of

from tests.contract.harness import NUMBER, TEXT, TWIST, Kind, SkilledSpace
from tests.system import Processes
from ua_fleet.bridge import Driver, DriverStatus, Dropped, Inlet, SampleRead, SourceFound, SourceLost
from ua_fleet.counters import Drop
from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

NEEDS: tuple[str, ...] = ()
WARNINGS: tuple[str, ...] = ()

_log = logging.getLogger(__name__)

KINDS = {kind.ros_type: kind for kind in (NUMBER, TEXT, TWIST)}


class Item(NamedTuple):
    """What is said on the bus; a message has values."""

    name: str
    sender: object
    there: bool = True
    values: Mapping[str, Any] | None = None


class Bus:
    """Topics with publishers, and who listens to all of it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.is_up = False
        self.kinds: dict[str, Kind] = {}
        self._listeners: list[Callable[[Item], None]] = []

    def listen(self, listener: Callable[[Item], None]) -> None:
        """Hear all that is there, and all from now on."""
        with self._lock:
            self._listeners.append(listener)
            for name in self.kinds:
                listener(Item(name, None))

    def leave(self, listener: Callable[[Item], None]) -> None:
        """Hear nothing more."""
        with self._lock:
            self._listeners.remove(listener)

    def tell(self, item: Item, kind: Kind | None = None) -> None:
        """Say something to all; `kind` that a topic is there."""
        with self._lock:
            if kind is not None:
                self.kinds[item.name] = kind
            elif not item.there:
                del self.kinds[item.name]
            for listener in self._listeners:
                listener(item)


class VirtualRobot:
    """See Robot."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._wanted: dict[str, list[dict[str, Any]]] = {}
        bus.listen(self._hear)

    def _hear(self, item: Item) -> None:
        if item.values is not None and item.sender is not self and item.name in self._wanted:
            self._wanted[item.name].append(dict(item.values))

    def advertise(self, name: str, kind: Kind) -> None:
        """See Robot."""
        self._bus.tell(Item(name, self), kind)

    def publish(self, name: str, values: Mapping[str, Any]) -> None:
        """See Robot."""
        self._bus.tell(Item(name, self, values=values))

    def withdraw(self, name: str) -> None:
        """See Robot."""
        self._bus.tell(Item(name, self, there=False))

    def subscribe(self, name: str, kind: Kind) -> None:
        """See Robot."""
        self._wanted[name] = []

    def heard(self, name: str) -> list[dict[str, Any]]:
        """See Robot."""
        return list(self._wanted[name])


class VirtualDriver(Driver):
    """See Driver. Its thread plays the part of a robot library's thread."""

    def __init__(self, space: int, bus: Bus) -> None:
        self._space, self._bus = space, bus
        self._items: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._inlet: Inlet | None = None
        self._failure = ""

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._inlet = inlet
        self._thread = threading.Thread(target=self._run, args=(inlet,), name="virtual-driver")
        self._thread.start()
        self._bus.listen(self._items.put)

    def _run(self, inlet: Inlet) -> None:
        try:
            while (item := self._items.get()) is not None:
                self._take(item, inlet)
        except Exception as error:  # noqa: BLE001 - nobody else would hear of it: `status` tells
            _log.exception("the virtual driver ended")
            self._failure = f"a mistake of the bridge ({error!r}); report its log, and start it again"

    def _take(self, item: Item, inlet: Inlet) -> None:
        try:
            topic = Topic.parse(item.name)
        except TopicInvalid as error:
            if item.values is None and item.there:
                inlet.put(Dropped(Drop.ILLEGAL_TOPIC, 1, str(error)))
            return
        if topic.space != self._space:
            return
        if item.values is not None:
            own = item.sender is self
            inlet.put(SampleRead(topic, tuple(item.values.values()), time.time_ns(), own_publication=own))
        elif not item.there:
            inlet.put(SourceLost(topic))
        elif kind := self._bus.kinds.get(item.name):
            inlet.put(SourceFound(topic, item.name, kind.metadata(item.name).fields))

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        assert self._inlet is not None
        found = ros_type_of(metadata.fields)
        kind = None if found is None else KINDS.get(found[0])
        if kind is None:
            self._inlet.put(Dropped(Drop.TYPE_MISSING, 1, topic.name))
            return False
        if topic.name not in self._bus.kinds:
            self._bus.tell(Item(topic.name, self), kind)
        self._bus.tell(Item(topic.name, self, values=kind.values(*message.values)))
        return True

    def status(self) -> DriverStatus:
        """See Driver."""
        if self._thread is None:
            return DriverStatus(False, "not running")
        if self._failure:
            return DriverStatus(False, self._failure, is_over=True)
        return DriverStatus(self._bus.is_up, "the bus is up" if self._bus.is_up else "the bus is down; call appear()")

    async def stop(self) -> None:
        """See Driver."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._bus.leave(self._items.put)
            self._items.put(None)
            await asyncio.to_thread(thread.join)


class VirtualSpace:
    """See Space."""

    number = 300
    can_be_absent = True
    own_work = "tests.contract.virtual.VirtualDriver._take"

    def __init__(self) -> None:
        self.bus = Bus()
        self.robot = VirtualRobot(self.bus)

    def make_driver(self) -> Driver:
        """See Space."""
        return VirtualDriver(self.number, self.bus)

    def appear(self) -> None:
        """See Space."""
        self.bus.is_up = True


@asynccontextmanager
async def open_space(folder: Path, processes: Processes) -> AsyncGenerator[VirtualSpace]:
    """A new space."""
    yield VirtualSpace()


@asynccontextmanager
async def open_skilled_space(folder: Path, processes: Processes) -> AsyncGenerator[SkilledSpace]:
    """The machine of `skilled.py`."""
    from tests.contract.skilled import SkilledVirtualSpace

    yield SkilledVirtualSpace(folder / "machine")
