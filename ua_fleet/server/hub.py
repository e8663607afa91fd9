"""The shell of the server's core: the connections, the clocks, and the only tasks of the server beside its endpoint.

A datagram goes from the socket to the monitored items that watch its nodes within one callback. One task keeps the
time; with message security another one keeps the keys.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable
from functools import partial

from ua_fleet.config.applications import server_application
from ua_fleet.config.nodes import events_topic
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import keys_needed
from ua_fleet.counters import Drop
from ua_fleet.fleet.commands import Publication
from ua_fleet.fleet.model import RobotModel
from ua_fleet.keys.keeper import KeysKept, keep_keys
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.published_events import EVENT_FIELDS, EVENTS_NAME
from ua_fleet.operation.skills.tracker import SkillChange
from ua_fleet.pubsub.events import SubscriberEvent
from ua_fleet.pubsub.recent import RecentMessages
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.server.attached import Ground, Parts
from ua_fleet.server.core import ServerCore
from ua_fleet.server.ground import PubSubEnds
from ua_fleet.server.message_tap import MessageTap
from ua_fleet.server.timer import Timer
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.transport.base import Address
from ua_fleet.values import UNIX_EPOCH_TICKS
from ua_fleet.wire.discovered import EndpointDescription

__all__ = ["Hub", "wall_ticks"]


def wall_ticks() -> int:
    """The time of the wall clock."""
    return time.time_ns() // 100 + UNIX_EPOCH_TICKS  # as `ticks_from_unix_ns`: each datagram has one


class Hub:
    """Carries data between connections and core until it is cancelled; and gives the core the time of each call."""

    def __init__(
        self,
        config: FleetConfig,
        ends: PubSubEnds,
        ground: Ground,
        parts: Parts,
        *,
        timer: Timer,
        recent: RecentMessages,
        mistakes: Mistakes,
        keys: KeySource | None = None,
    ) -> None:
        """Make a hub.

        Args:
            config: rates, and where keys come from.
            ends: the connections, not started yet, which `start` does; how messages are secured and sent.
            ground: of the core.
            parts: of the server.
            timer: polls the core.
            recent: the last messages, while somebody looks at them.
            mistakes: counts what has cost an item.
            keys: where the keys of message security come from; not needed where it is `none`.

        Raises:
            ConfigError: no key source is configured.
        """
        self.connections, self.counters, self.envelopes = ends.connections, ends.counters, ends.envelopes
        self._config, self._ground, self._timer, self._mistakes = config, ground, timer, mistakes
        self._loop = asyncio.get_running_loop()
        self._keys, self.keys_kept = keys_needed(config, SERVER_SPACE, keys), KeysKept()
        self._recent = recent
        self._tap = MessageTap(recent, ground.subscriber, ends.sender, ends.counters, wall_ticks)
        events = events_topic(config)
        self._core = ServerCore(
            ground,
            parts,
            analog_rate_hz=config.server.analog_rate_hz,
            each_second=self._each_second,
            events=None if events is None else (EVENTS_NAME, events, EVENT_FIELDS),
        )
        self.connections.speak_for(SERVER_SPACE, self._receive, ground.publisher.names_of)
        self._flush_is_due = False

    async def start(self) -> None:
        """Open the connections; data reaches the nodes from now on.

        Raises:
            TransportError: it cannot be opened.
        """
        await self.connections.start(self._receive)

    async def run(self) -> None:
        """Announce what originates here, then keep the time until cancelled. Nothing but that ends it."""
        keep = self._mistakes.keep
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(keep("timer", partial(self._timer.run, self._poll, self._core.next_deadline)))
            if self._keys is not None:
                tasks.create_task(keep("keys", partial(self._keep_keys, self._keys)))
                await self.keys_kept.wait_for([telemetry_group(SERVER_SPACE)])
            self._core.begin(now=self._loop.time(), wall=wall_ticks())
            self._timer.sooner()

    async def close(self) -> None:
        """Say that this ends, and release the connections."""
        self._core.end()
        await self.connections.close()

    async def _keep_keys(self, keys: KeySource) -> None:
        count = self._config.pubsub.keys.future_keys + 1
        await keep_keys(self.envelopes, keys, self.keys_kept, count=count, mistakes=self._mistakes)

    def _receive(self, datagram: bytes, sender: Address, *, is_fresh: bool = True, connection: int = 0) -> None:
        if self._recent.is_wanted:
            with self._mistakes.guard("recent messages"):
                hand_on = partial(self._hand_on, is_fresh=is_fresh, connection=connection)
                self._tap.received(datagram, sender, hand_on)
        else:
            now, wall = self._loop.time(), wall_ticks()
            self._core.receive(datagram, sender, now=now, wall=wall, is_fresh=is_fresh, connection=connection)
        self._timer.sooner()

    def _hand_on(self, datagram: bytes, sender: Address, *, is_fresh: bool = True, connection: int = 0) -> None:
        now, wall = self._loop.time(), wall_ticks()
        self._core.receive(datagram, sender, now=now, wall=wall, is_fresh=is_fresh, connection=connection)

    def _poll(self, now: float) -> bool:
        return self._core.poll(now=now, wall=wall_ticks())

    def _each_second(self, now: float) -> None:
        self.connections.count_drops(self.counters)
        self.counters.drops[Drop.SEND_FAILED] += self._core.refused
        self._recent.poll(now)

    # What parts and clients ask of the core.

    def describe(self, endpoints: tuple[EndpointDescription, ...]) -> None:
        """Tell the server's Endpoints to who asks for them on PubSub."""
        self._ground.publisher.describe(server_application(self._config, endpoints))

    def hear(self, event: SubscriberEvent) -> None:
        """Take what would have come by PubSub from a robot whose skills clients do."""
        self._core.hear([event], now=self._loop.time(), wall=wall_ticks())
        self._timer.sooner()

    def hear_all(self, events: Iterable[SubscriberEvent]) -> None:
        """Take what comes of DataSetReaders that somebody has disabled or enabled."""
        self._core.hear(events, now=self._loop.time(), wall=wall_ticks())
        self._timer.sooner()

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """The outcome of a request is known, or known better."""
        self._core.concluded(execution_id, outcome, now=self._loop.time(), wall=wall_ticks())

    def show_skills(self, changes: Iterable[SkillChange]) -> None:
        """Show what has become of executions, in the order in which it happened."""
        self._core.show_skills(changes, now=self._loop.time(), wall=wall_ticks())

    def add_robot(self, robot: RobotModel) -> None:
        """Know a robot from now on; clients see it when this returns."""
        self._core.add_robot(robot, now=self._loop.time(), wall=wall_ticks())
        self._timer.sooner()

    def remove_robot(self, robot: RobotModel, *, is_replaced: bool = False) -> None:
        """Forget a robot that does nothing; `is_replaced`: it comes again at once, with another definition."""
        self._core.remove_robot(robot, now=self._loop.time(), is_replaced=is_replaced)

    def set_faulted(self, robot: str, faulted: bool) -> None:
        """A robot has a fault that is more than its silence, or none."""
        self._core.set_faulted(robot, faulted, now=self._loop.time(), wall=wall_ticks())

    def set_driven(self, robot: str, by: str) -> None:
        """Somebody drives a robot by hand, in words; empty: nobody."""
        self._core.set_driven(robot, by, now=self._loop.time(), wall=wall_ticks())

    def publish(self, publication: Publication) -> None:
        """Send a DataSet of space 0."""
        self._core.publish(publication, now=self._loop.time())
        self._timer.sooner()

    def publish_event(self, publication: Publication) -> None:
        """Send an event of the server's own."""
        self._core.publish_event(publication, now=self._loop.time())

    def flush_soon(self) -> None:
        """Publish what clients have written, in the next turn of the event loop."""
        if not self._flush_is_due:
            self._flush_is_due = True
            self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._flush_is_due = False
        self._core.flush(now=self._loop.time())
        self._timer.sooner()
