# pyright: basic, reportMissingImports=false
"""This process as a node of a ROS 2 domain: one context, one node, one executor.

rclpy's EventsExecutor is the fastest one, and unforgiving: an exception that leaves a callback ends the process with a
segmentation fault, its `spin()` hangs when another thread publishes, and it cannot call a callback with a message's
info as two arguments. So everything that it calls is guarded, `spin_once` is called in a loop, and a subscription gets
message and info as one pair. Entities are made and destroyed in the node's thread only.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, Literal

import structlog

from ua_bridges.ros2.classes import load_type, load_usual_types
from ua_bridges.ros2.environment import dds_environment
from ua_bridges.ros2.graph import Publisher
from ua_bridges.ros2.qos import Offer, Qos
from ua_fleet.errors import BridgeUnavailable
from ua_fleet.topics import check_ros2_space

__all__ = ["Ros2Node", "guarded", "leave", "make_node", "make_profile"]

_PARTICIPANT_BYTES: Final = 12
"""All endpoints of a participant have the first 12 bytes of its GUID in common (DDSI-RTPS 9.3.1)."""
_SELF_MATCH_S: Final = 0.2
_PROBE: Final = Qos(reliable=True, transient_local=False, depth=1)

_log = structlog.get_logger(__name__)


def guarded(callback: Callable[..., None]) -> Callable[..., None]:
    """`callback` with every exception logged, for the EventsExecutor."""

    def call(*args: Any) -> None:
        try:
            callback(*args)
        except Exception:  # noqa: BLE001 - one that got out would end the process with a segmentation fault
            _log.exception("a callback of the ROS 2 bridge failed")

    return call


def _policy_teller(on_incompatible: Callable[[str], None]) -> Callable[[Any], None]:
    """An event callback that hands on the name of the policy, e.g. `durability`."""
    from rclpy.qos import qos_policy_name_from_kind

    return guarded(lambda event: on_incompatible(qos_policy_name_from_kind(event.last_policy_kind).lower()))


def _ignore(_policy: str) -> None:
    """For topics that nobody else knows."""


def make_profile(qos: Qos) -> Any:
    """The profile with which rclpy says a quality of service."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE,
    )


def make_node(domain: int, name: str, discovery: Literal["localhost", "subnet"]) -> tuple[Any, Any]:
    """A context with a participant of its own, and its node.

    Raises:
        TopicInvalid: no legal domain; the middleware would end the process for it.
        BridgeUnavailable: rclpy or its middleware is not installed, or does not start.
    """
    check_ros2_space(domain)
    try:
        from rclpy.context import Context
        from rclpy.exceptions import InvalidHandle
    except ImportError as error:
        raise BridgeUnavailable(f"the ROS 2 library does not load ({error})", extra="ros2") from error
    context = Context()
    try:
        with dds_environment(discovery):
            context.init(args=[], initialize_logging=False, domain_id=domain)
            node = _node_in(context, name)
    except (RuntimeError, InvalidHandle) as error:  # rclpy's RCLError is a RuntimeError
        context.try_shutdown()
        raise BridgeUnavailable(f"no ROS 2 node in domain {domain}: {' '.join(str(error).split())}") from error
    return context, node


def _node_in(context: Any, name: str) -> Any:
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    return Node(
        name,
        context=context,
        cli_args=[],
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
    )


def leave(context: Any, node: Any) -> None:
    """End a node and its context."""
    node.destroy_node()
    context.try_shutdown()
    context.destroy()


class Ros2Node:
    """The bridge's node and its part of the graph. All methods belong to the node's thread."""

    def __init__(
        self, domain: int, name: str, discovery: Literal["localhost", "subnet"], beside: Ros2Node | None = None
    ) -> None:
        """Join the domain; takes 0.1 to 0.5 s.

        Args:
            domain: its id.
            name: of the node.
            discovery: how far it looks.
            beside: a node whose participant this one shares, so that both are one to the loop rule. It ends first.

        Raises:
            TopicInvalid, BridgeUnavailable: see `make_node`.
        """
        self._is_guest = beside is not None
        if beside is None:
            self._context, self.node = make_node(domain, name, discovery)
        else:
            self._context = beside.context
            self.node = _node_in(self._context, name)
        from rclpy.duration import Duration
        from rclpy.exceptions import InvalidHandle
        from rclpy.experimental.events_executor import EventsExecutor
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        self.no_time: Any = Duration()
        """A timeout that asks and does not wait."""
        self.destroyed: type[Exception] = InvalidHandle
        """What rclpy raises of an entity that is destroyed."""
        self._reliable, self._transient_local = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
        self.executor: Any = EventsExecutor(context=self._context)
        self.executor.add_node(self.node)
        load_usual_types()
        self.participant: bytes = self._find_participant() if beside is None else beside.participant
        """The first bytes of the GIDs of all endpoints of this node, and of those beside it."""

    @property
    def context(self) -> Any:
        """The context, which has the participant."""
        return self._context

    def _find_participant(self) -> bytes:
        """The prefix of our own GIDs. rclpy tells nobody's, so we look ourselves up under a name that nobody has."""
        name = f"_ua_fleet_{os.urandom(8).hex()}"
        publisher = self.create_publisher(load_type("std_msgs/Bool").cls, name, _PROBE, _ignore)
        try:
            for _ in range(100):
                for info in self.node.get_publishers_info_by_topic(name):
                    return bytes(info.endpoint_gid)[:_PARTICIPANT_BYTES]
                time.sleep(0.005)
        finally:
            self.node.destroy_publisher(publisher)
        raise BridgeUnavailable("the ROS 2 middleware does not show the bridge's own endpoints in its graph")

    def hears_itself(self) -> bool:
        """Whether the node's subscriptions match its own publishers, which its Fast DDS profile should prevent."""
        name = f"_ua_fleet_{os.urandom(8).hex()}"
        message_class = load_type("std_msgs/Bool").cls
        publisher = self.create_publisher(message_class, name, _PROBE, _ignore)
        subscription = self.create_subscription(message_class, name, _PROBE, lambda _pair, _info=None: None, _ignore)
        end = time.monotonic() + _SELF_MATCH_S
        while not publisher.get_subscription_count() and time.monotonic() < end:
            time.sleep(0.01)
        heard = bool(publisher.get_subscription_count())
        self.node.destroy_subscription(subscription)
        self.node.destroy_publisher(publisher)
        return heard

    def create_subscription(
        self,
        message_class: Any,
        topic_name: str,
        qos: Qos,
        on_pair: Callable[..., None],
        on_incompatible: Callable[[str], None],
        *,
        raw: bool = False,
    ) -> Any:
        """A subscription whose callback gets (message, info) as one argument, or as two where rclpy is repaired.

        With `raw` the message is the bytes that it has come in. `on_incompatible` gets the name of the policy in which
        a publisher offers less than is asked for.
        """
        from rclpy.event_handler import SubscriptionEventCallbacks

        events = SubscriptionEventCallbacks(
            incompatible_qos=_policy_teller(on_incompatible), use_default_callbacks=False
        )
        subscription = self.node.create_subscription(
            message_class, topic_name, on_pair, make_profile(qos), event_callbacks=events, raw=raw
        )
        subscription._callback_type = subscription.CallbackType.WithMessageInfo  # noqa: SLF001 - see the module's text
        return subscription

    def listen(self, message_class: Any, topic_name: str, qos: Qos, heard: Callable[[Any], None]) -> None:
        """Hand each message of a topic on, until the node ends."""

        def on_pair(pair: Any, info: Any = None) -> None:
            heard(pair[0] if info is None else pair)

        self.create_subscription(message_class, topic_name, qos, guarded(on_pair), _ignore)

    def create_publisher(
        self, message_class: Any, topic_name: str, qos: Qos, on_incompatible: Callable[[str], None]
    ) -> Any:
        """A publisher; its `publish` may be called from any thread. `on_incompatible` as for a subscription."""
        from rclpy.event_handler import PublisherEventCallbacks

        events = PublisherEventCallbacks(incompatible_qos=_policy_teller(on_incompatible), use_default_callbacks=False)
        return self.node.create_publisher(message_class, topic_name, make_profile(qos), event_callbacks=events)

    def topic_names(self) -> Iterator[str]:
        """All topics of the graph."""
        return (name for name, _types in self.node.get_topic_names_and_types())

    def count_publishers(self, topic_name: str) -> int:
        """How many publishers a topic has, our own included."""
        return int(self.node.count_publishers(topic_name))

    def count_subscribers(self, topic_name: str) -> int:
        """How many subscribers a topic has."""
        return int(self.node.count_subscribers(topic_name))

    def publishers(self, topic_name: str) -> Iterator[Publisher]:
        """The publishers of a topic."""
        for info in self.node.get_publishers_info_by_topic(topic_name):
            gid = bytes(info.endpoint_gid)
            yield Publisher(info.topic_type, self._offer(gid, info), gid.startswith(self.participant))

    def subscribers(self, topic_name: str) -> Iterator[Publisher]:
        """The subscribers of a topic, with what they ask for."""
        for info in self.node.get_subscriptions_info_by_topic(topic_name):
            gid = bytes(info.endpoint_gid)
            yield Publisher(info.topic_type, self._offer(gid, info), gid.startswith(self.participant))

    def _offer(self, gid: bytes, info: Any) -> Offer:
        profile = info.qos_profile
        return Offer(
            gid,
            profile.reliability == self._reliable,
            profile.durability == self._transient_local,
        )

    def close(self) -> None:
        """Leave the domain."""
        self.executor.shutdown()
        if self._is_guest:
            self.node.destroy_node()
        else:
            leave(self._context, self.node)
