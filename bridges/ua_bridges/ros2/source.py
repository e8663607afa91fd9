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

from ua_bridges.ros.errors import ConversionError, Unreadable
from ua_bridges.ros.feed import Feed, Read
from ua_bridges.ros.serialized import stamp_reader
from ua_bridges.ros.stamp import source_time_ns
from ua_bridges.ros.topic_mapping import QosConfig
from ua_bridges.ros2.arrivals import Arrivals
from ua_bridges.ros2.classes import MessageType, load_type
from ua_bridges.ros2.graph import Publisher
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.qos import QUEUE_DEPTH, Qos, choose, is_outdated
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.counters import Drop
from ua_fleet.errors import UaFleetError

__all__ = ["RosSource"]

MOST_EARLY: Final = 1000
"""Messages that may wait for the look that finds their publisher."""
GONE_S: Final = 2.0
"""A publisher that no look has found for so long after its first message came and went between two looks."""
MOST_BAD: Final = 10
"""So many messages in a row that make the bridge fail, and their topic is put aside."""
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
        clock: Callable[[], float] = time.monotonic,
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
            clock: gives seconds of a monotonic clock.
        """
        self.name = name
        self._feeds = feeds
        self._node = node
        self._arrivals = inlet if isinstance(inlet, Arrivals) else Arrivals(inlet)
        self._put = inlet.put
        self._look_now, self._clock = look_now, clock
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
        self._early: list[tuple[bytes, Any]] = []
        self._early_since = 0.0
        self._overdue: tuple[bytes, Any] | None = None
        """The last message, where it had waited too long: it is handed on if no newer one comes."""
        self._told: set[str] = set()
        self._bad = 0
        """Messages in a row that made the bridge fail."""
        self.offence: str | None = None
        """What its publishers do that no robot should; None as long as they do not."""

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
                    feed.announce(kind, latched)
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
            kind.cls, self.name, qos, self._make_callback(kind), self._on_incompatible, raw=True
        )

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._node.node.destroy_subscription(self._subscription)
            self._subscription = None

    def _make_callback(self, kind: MessageType, *, even_old: bool = False) -> Callable[..., None]:
        """The subscription's callback, with all that it needs at hand."""
        reads, recent, stamp, arrivals = self._reads, self._recent, stamp_reader(kind), self._arrivals
        max_wait_s = arrivals.max_wait_s([feed.topic for feed in self._feeds])

        def on_message(pair: Any, info: Any = None) -> None:
            try:
                content, info = pair if info is None else (pair, info)
                is_old = arrivals.begin(info["received_timestamp"], max_wait_s)
                sent_ns = info["source_timestamp"]
                if sent_ns in recent:
                    return
                if self._overdue is not None:
                    self._overdue = None
                    self._put(Dropped(Drop.TOO_OLD))
                if is_old and self._found and not even_old:
                    self._overdue = content, info
                    return
                if not self._found:
                    self._wait_for_look(content, info)
                    return
                recent[sent_ns] = None
                if len(recent) > QUEUE_DEPTH:
                    del recent[next(iter(recent))]
                time_ns = source_time_ns(sent_ns, info["received_timestamp"])
                if stamp is not None:
                    time_ns = source_time_ns(stamp(content), time_ns)
                for read in reads:
                    read(content, time_ns, False)  # a node of ROS 2 does not hear itself
                self._bad = 0
            except ConversionError as error:
                self._put(Dropped(Drop.CONVERSION, detail=self._tell_once(f"{self.name}: {error}")))
                if isinstance(error, Unreadable):
                    self._count_bad(error)
            except Exception as error:  # noqa: BLE001 - one that got out would end the process with a segmentation fault
                if not self._bad:
                    _log.exception("a message could not be read", topic=self.name)
                self._put(Dropped(Drop.CONVERSION))
                self._count_bad(error)
            finally:
                arrivals.end()

        return on_message

    def _count_bad(self, error: Exception) -> None:
        self._bad += 1
        if self._bad >= MOST_BAD:
            self.offence = f"{MOST_BAD} messages in a row could not be read ({type(error).__name__})"

    def _wait_for_look(self, content: bytes, info: Any) -> None:
        if len(self._early) >= MOST_EARLY:
            self._put(Dropped(Drop.INLET_FULL))
            return
        if not self._early:
            self._early_since = self._clock()
            self._look_now()
        self._early.append((content, info))

    def looked(self) -> None:
        """Hand on what has waited for a look at the graph, and what no newer message has followed."""
        overdue, self._overdue = self._overdue, None
        if overdue is not None and self._kind is not None:
            self._make_callback(self._kind, even_old=True)(overdue)
        if not self._early:
            return
        # The graph learns of publishers a little later than subscriptions do. To say at once that the source came and
        # went would have it be lost and found with each message of one that a look does not find.
        if not self._found and self._kind is not None and self._clock() < self._early_since + GONE_S:
            return
        early, self._early = self._early, []
        if self._kind is None:
            self._put(Dropped(Drop.TYPE_MISSING, len(early)))  # its publishers have another type by now
            return
        is_gone = not self._found
        if is_gone:  # its publisher came and went between two looks
            for feed in self._feeds:
                feed.announce(self._kind, self._qos.transient_local)
            self._found = True
        on_message = self._make_callback(self._kind)
        for pair in early:
            on_message(pair)
        if is_gone:
            self._lose()

    @property
    def is_waiting(self) -> bool:
        """Whether messages wait for a look at the graph."""
        return bool(self._early) or self._overdue is not None

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
