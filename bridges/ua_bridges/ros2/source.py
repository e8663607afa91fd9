# pyright: basic, reportMissingImports=false
"""One topic of the ROS 2 graph that the bridge listens to. All of it runs in the node's thread.

    publishers  subscription    what is said
    none        none, or kept   nothing; SourceLost when they have just gone
    some        made for them   SourceFound, then each message once

The subscription is kept while nobody publishes, so that the first message of a publisher that returns is not missed.
Such a message may be here before the look at the graph that finds its publisher: it waits for that look.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import structlog

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.stamp import source_time_ns
from ua_bridges.ros2.classes import MessageType, load_type
from ua_bridges.ros2.feed import Feed, Read
from ua_bridges.ros2.graph import Publisher
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.qos import QUEUE_DEPTH, Qos, choose, is_outdated
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.config.schema import QosConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import UaFleetError

__all__ = ["RosSource"]

MOST_EARLY: Final = 1000
"""Messages that may wait for the look that finds their publisher."""
MOST_TOLD: Final = 20
"""Different mistakes of one topic that are told until its source is lost."""

_log = structlog.get_logger("ua_bridges.ros2")


class RosSource:
    """A watched topic: its subscription follows the publishers that are there."""

    def __init__(
        self,
        name: str,
        feeds: Sequence[Feed],
        node: Ros2Node,
        inlet: Inlet,
        look_now: Callable[[], None],
        *,
        wanted_type: str | None = None,
        qos: QosConfig | None = None,
    ) -> None:
        """Watch a topic.

        Args:
            name: full name of the topic.
            feeds: the DataSets that are read from it.
            node: the bridge's node.
            inlet: where drops are told.
            look_now: asks for a look at the graph as soon as possible.
            wanted_type: `pkg/Name`, where `fleet.yaml` says it.
            qos: quality of service, where `fleet.yaml` says it.
        """
        self.name = name
        self._feeds = feeds
        self._node = node
        self._put = inlet.put
        self._look_now = look_now
        self._wanted_type = wanted_type.replace("/msg/", "/") if wanted_type else None
        self._choose: Callable[[Sequence[Any]], Qos] = choose if qos is None else lambda offers: choose(offers, qos)
        self._is_configured = qos is not None and (qos.reliability is not None or qos.durability is not None)
        self._found = False
        self._kind: MessageType | None = None
        self._reads: tuple[Read, ...] = ()
        self._subscription: Any = None
        self._qos = Qos(reliable=False, transient_local=False, depth=0)
        self._made_for: frozenset[bytes] = frozenset()
        self._recent: dict[int, None] = {}
        """Source timestamps handed on: a subscription that is made again gets transient local history again."""
        self._early: list[tuple[Any, Any]] = []
        self._told: set[str] = set()

    def follow(self, publishers: Sequence[Publisher]) -> None:
        """Take note of the publishers that are there now, our own left out."""
        if not publishers:
            self._lose()
            return
        present = {publisher.type for publisher in publishers}
        ros_type = self._pick_type([publisher.type for publisher in publishers])
        if len(present) > 1 and (told := self._tell_once(f"{self.name}: publishers disagree about the type")):
            self._put(Dropped(Drop.CONFLICT, detail=f"{told}: {', '.join(sorted(present))}; {ros_type} is read"))
        if self._wanted_type is not None and ros_type.replace("/msg/", "/") != self._wanted_type:
            self._mistyped(ros_type)
            return
        try:
            kind = load_type(ros_type)
        except UaFleetError as error:
            if told := self._tell_once(f"{self.name}: {error}"):
                self._put(Dropped(Drop.TYPE_MISSING, detail=told))
            return
        offers = [publisher.offer for publisher in publishers if publisher.type == ros_type]
        qos = self._choose(offers)
        present_gids = {offer.gid for offer in offers}
        outdated = (
            self._subscription is None
            or kind is not self._kind
            or is_outdated(self._qos, qos, self._made_for, present_gids)
        )
        if not self._found or kind is not self._kind:
            latched = bool(offers) and all(offer.transient_local for offer in offers)
            try:
                for feed in self._feeds:
                    feed.found(kind, latched)
            except UaFleetError as error:
                if told := self._tell_once(f"{self.name}: {error}"):
                    self._put(Dropped(Drop.TYPE_MISSING, detail=told))
                return
            self._found = True
        if outdated:
            self._subscribe(kind, qos)
            self._made_for = frozenset(present_gids)

    def _pick_type(self, types: Sequence[str]) -> str:
        """The type to read: that of `fleet.yaml`, else that which is read already, else the first publisher's."""
        preferred = self._wanted_type or (self._kind.name if self._kind is not None else None)
        return next((each for each in types if each.replace("/msg/", "/") == preferred), types[0])

    def _mistyped(self, ros_type: str) -> None:
        if self._found and self._kind is None:
            return
        self._unsubscribe()
        self._found, self._kind = True, None
        for feed in self._feeds:
            feed.mistyped(ros_type, time.time_ns())

    def _subscribe(self, kind: MessageType, qos: Qos) -> None:
        self._unsubscribe()
        self._kind, self._qos = kind, qos
        self._reads = tuple(feed.reader(kind) for feed in self._feeds)
        self._subscription = self._node.create_subscription(
            kind.cls, self.name, qos, self._make_callback(kind), self._on_incompatible
        )

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._node.node.destroy_subscription(self._subscription)
            self._subscription = None

    def _make_callback(self, kind: MessageType) -> Callable[..., None]:
        """The subscription's callback, with all that it needs at hand."""
        reads, recent, has_header = self._reads, self._recent, kind.has_header

        def on_message(pair: Any, info: Any = None) -> None:
            try:
                message, info = pair if info is None else (pair, info)
                sent_ns = info["source_timestamp"]
                if sent_ns in recent:
                    return
                if not self._found:
                    self._wait_for_look(message, info)
                    return
                recent[sent_ns] = None
                if len(recent) > QUEUE_DEPTH:
                    del recent[next(iter(recent))]
                time_ns = source_time_ns(sent_ns, info["received_timestamp"])
                if has_header:
                    stamp = message.header.stamp
                    time_ns = source_time_ns(stamp.sec * 1_000_000_000 + stamp.nanosec, time_ns)
                for read in reads:
                    read(message, time_ns)
            except ConversionError as error:
                self._put(Dropped(Drop.CONVERSION, detail=self._tell_once(f"{self.name}: {error}")))
            except Exception:  # noqa: BLE001 - one that got out would end the process with a segmentation fault
                _log.exception("a message could not be read", topic=self.name)
                self._put(Dropped(Drop.CONVERSION))

        return on_message

    def _wait_for_look(self, message: Any, info: Any) -> None:
        if len(self._early) >= MOST_EARLY:
            self._put(Dropped(Drop.INLET_FULL))
            return
        self._early.append((message, info))
        self._look_now()

    def looked(self) -> None:
        """Hand on what has waited for a look at the graph."""
        if not self._early:
            return
        early, self._early = self._early, []
        if self._kind is None:
            return
        is_gone = not self._found
        if is_gone:  # its publisher came and went between two looks
            for feed in self._feeds:
                feed.found(self._kind, self._qos.transient_local)
            self._found = True
        on_message = self._make_callback(self._kind)
        for pair in early:
            on_message(pair)
        if is_gone:
            self._lose()

    def release(self, now: float) -> float | None:
        """Hand on what has waited for its turn under a rate limit; when to ask again."""
        due = [when for feed in self._feeds if (when := feed.release(now)) is not None]
        return min(due) if due else None

    def _lose(self) -> None:
        if self._found:
            self._found = False
            self._recent.clear()  # it is shown as Bad from now on: what it sends again makes it good
            for feed in self._feeds:
                feed.lost()
        self._told.clear()

    def _tell_once(self, text: str) -> str:
        """The text the first time, then nothing."""
        if text in self._told or len(self._told) >= MOST_TOLD:
            return ""
        self._told.add(text)
        return text

    def _on_incompatible(self, policy: str) -> None:
        """A publisher offers less than we ask for. Unless `fleet.yaml` asks for it, the next look mends that."""
        if not self._is_configured and policy in ("reliability", "durability"):
            self._look_now()
            return
        told = self._tell_once(
            f"{self.name}: a publisher offers another {policy} than the bridge asks for, so that nothing comes "
            "from it; correct `qos` of the mapping, or leave it out"
        )
        self._put(Dropped(Drop.INCOMPATIBLE_QOS, detail=told))

    def close(self) -> None:
        """End the subscription; the source is lost with it."""
        self._lose()
        self._unsubscribe()
