"""A bridge whose PubSub is disabled and enabled from the server: an Action in, switches set, an answer out. Pure.

While its PubSubConnection is Disabled a bridge sends and takes no data and no setpoints, and begins no skill: nobody
would see what becomes of it. What is under way goes on, and can be halted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from ua_fleet.bridge.immediate import ImmediateActions
from ua_fleet.counters import Counters
from ua_fleet.errors import LocalWireError, UaFleetError
from ua_fleet.pubsub.components import CONNECTION
from ua_fleet.pubsub.events import ActionReceived, SubscriberEvent
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.switch_action import SWITCH, SWITCH_REQUEST, component_of, switch_topic
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.transport.addresses import answer_address
from ua_fleet.transport.party import Answers
from ua_fleet.values import StatusCode
from ua_fleet.wire.actions import ActionMessage

__all__ = ["BridgeSwitches"]

_REQUESTS_AT_ONCE: Final = 4


class NoSuchComponent(UaFleetError):
    """A bridge is asked to switch what it does not have."""

    ua_status = StatusCode.BAD_NOT_FOUND
    remedy = "Browse the WriterGroups and DataSetWriters of the bridge once more."


class BridgeSwitches:
    """The switches of one bridge."""

    def __init__(
        self,
        name: str,
        space: int,
        ns: int,
        publisher: Publisher,
        subscriber: Subscriber,
        counters: Counters,
        *,
        requestors: Iterable[int],
        must_be_verified: bool,
        send: Callable[[bytes], None],
        send_to: Callable[[bytes, tuple[str, int]], None],
        wall_ticks: Callable[[], int],
        hear: Callable[[Iterable[SubscriberEvent], float], None],
        told: Callable[[str, bool], None],
        failed: Callable[[str, BaseException | None], None],
        caught: Callable[[str, Exception], None],
        answers: Answers = answer_address,
        limits: ResponderLimits | None = None,
    ) -> None:
        """Connect the parts.

        Args:
            name: the bridge's, which is that of the Action's target.
            space: the bridge's.
            ns: the fleet's namespace.
            publisher: what is switched of what the bridge sends, and what announces the Action.
            subscriber: takes nothing while the PubSubConnection is Disabled.
            counters: of the bridge.
            requestors: spaces that may command this one; of these the server alone may ask for this.
            must_be_verified: whether keys are configured: unsigned requests are dropped then.
            send: sends a plain message to all.
            send_to: sends a plain message to one address.
            wall_ticks: the time of the wall clock.
            hear: takes what the end of reading brings.
            told: told for the log what was switched, and whether it is enabled.
            failed: told what an operator has to know.
            caught: told of a mistake, and what it was about.
            answers: finds where a response goes.
            limits: of the responder; the usual ones if left out.
        """
        self._name, self._topic = name, switch_topic(space, ns)
        self._publisher, self._subscriber = publisher, subscriber
        self._send, self._wall_ticks, self._hear = send, wall_ticks, hear
        self._told, self._failed = told, failed
        self._actions = ImmediateActions(
            space,
            publisher,
            counters,
            self._asked,
            about="switches",
            requestors=requestors,
            must_be_verified=must_be_verified,
            requests_at_once=_REQUESTS_AT_ONCE,
            send=send,
            send_to=send_to,
            wall_ticks=wall_ticks,
            caught=caught,
            answers=answers,
            limits=limits,
        )

    @property
    def problem(self) -> str:
        """Why the bridge begins nothing now; empty where it may."""
        if self._publisher.switches.components.is_enabled(CONNECTION):
            return ""
        return "the PubSubConnection of its bridge is Disabled; enable it first"

    def begin(self, now: float) -> None:
        """Announce the Action."""
        try:
            self._actions.offer(self._topic, SWITCH, self._name, SWITCH_REQUEST, (), now)
        except LocalWireError as error:
            self._failed(f"PubSub of this bridge cannot be disabled from the server: {error}", None)

    def takes(self, message: ActionMessage) -> bool:
        """Whether a request is for this."""
        return message.data_set_writer_id == self._topic.id

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take a request."""
        self._actions.receive(event, now)

    def poll(self, now: float) -> None:
        """Do what is due."""
        self._actions.poll(now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self._actions.next_deadline()

    def _asked(self, _writer_id: int, values: list[Any], now: float) -> bytes:
        """Switch what was asked for."""
        ns, writer_id, is_enabled = values
        self._switch(ns, writer_id, is_enabled=is_enabled, now=now)
        return b""

    def _switch(self, ns: int, writer_id: int, *, is_enabled: bool, now: float) -> None:
        component, switches = component_of(ns, writer_id), self._publisher.switches
        if not self._has(ns, writer_id):
            raise NoSuchComponent(f"there is no DataSetWriter {writer_id} in a WriterGroup {ns} here")
        if is_enabled:
            datagrams = switches.enable(component, now=now)
        else:
            datagrams = switches.disable(component, timestamp=self._wall_ticks(), now=now)
        for datagram in datagrams:
            self._send(datagram)
        if component == CONNECTION:
            if is_enabled:
                self._subscriber.enable(CONNECTION)
            else:
                self._hear(self._subscriber.disable(CONNECTION), now)
        what = f"DataSetWriter {writer_id} of WriterGroup {ns}" if writer_id else f"WriterGroup {ns}"
        self._told(what if ns else "the PubSubConnection", is_enabled)

    def _has(self, ns: int, writer_id: int) -> bool:
        """Whether there is such a component."""
        topics = [topic for topic, writer in self._publisher.writers.items() if writer.encode is not None]
        if not ns:
            return not writer_id
        return any(topic[1] == ns and writer_id in (0, topic[2]) for topic in topics)
