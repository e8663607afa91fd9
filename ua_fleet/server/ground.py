"""What the core and all parts of a server stand on, made from its configuration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import structlog

from ua_fleet.config.applications import server_application
from ua_fleet.config.nodes import mapped_sources, max_ages_of, writer_settings
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import publisher_ids
from ua_fleet.config.transports import connections_of
from ua_fleet.counters import Counters
from ua_fleet.fleet.commands import Commands
from ua_fleet.fleet.model import FleetModel
from ua_fleet.fleet.state import FleetState
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.operation.skills.commands import SkillCommands, Told
from ua_fleet.operation.skills.tracker import SkillTracker
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import LoopRule, Subscriber
from ua_fleet.pubsub.timestamps import Timestamps
from ua_fleet.server.attached import Ground
from ua_fleet.skill.journal import RequestorJournal
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.transport.base import Transport
from ua_fleet.transport.connections import Sender
from ua_fleet.transport.sealed import SealedSender, Sent
from ua_fleet.wire import Codec

__all__ = ["PubSubEnds", "make_ground"]

LEAST_WRITERS: Final = 50_000
"""DataSetWriters that a server can know at least; a fleet with many sources knows twice as many as there may be."""

_log: Any = structlog.get_logger("ua_fleet.server")


class PubSubEnds:
    """How a server secures what it sends, and opens what comes."""

    def __init__(
        self,
        config: FleetConfig,
        state_dir: Path,
        transports: Transport | Sequence[Transport],
        clock: Callable[[], float],
        sent: Sent | None = None,
    ) -> None:
        """Make them.

        Args:
            config: how messages are secured.
            state_dir: where the server remembers which nonces it has used; touched only with message security.
            transports: one for each connection of the server, in their order; a single one may stand alone.
            clock: monotonic seconds.
            sent: told of each message that is sent.

        Raises:
            ConfigError: what stands in `state_dir` cannot be used.
        """
        self.counters = Counters()
        self.connections = connections_of(config, SERVER_SPACE, self.counters, state_dir, transports)
        self.envelopes = self.connections.envelopes
        sealed = [SealedSender(each.envelope, each.transport, clock, sent) for each in self.connections.all]
        self.sender = Sender(self.connections, sealed, self.counters)


def make_ground(
    config: FleetConfig,
    model: FleetModel,
    ends: PubSubEnds,
    journal: RequestorJournal,
    mistakes: Mistakes,
    *,
    rule: LoopRule,
    told: Told,
    sooner: Callable[[], None],
    clock: Callable[[], float],
    wall_ticks: Callable[[], int],
) -> Ground:
    """Make it.

    Args:
        config: periods, and the policy for unknown sources.
        model: the robots that there are.
        ends: how messages are secured and sent.
        journal: what robots were asked to do, through restarts.
        mistakes: counts what has cost an item.
        rule: the loop rule.
        told: learns of the outcomes of requests.
        sooner: called when the requestor's deadline may have come nearer.
        clock: monotonic seconds.
        wall_ticks: the wall clock.
    """
    timing, codec, counters = config.pubsub.timing(), Codec(), ends.counters
    first, *further = ends.connections.all
    most_sources = config.server.max_discovered_sources
    subscriber = Subscriber(
        SERVER_SPACE,
        timing,
        counters,
        codec,
        rule,
        envelope=first.envelope,
        barred=first.barred,
        relayed=first.relayed,
        takes_actions=first.takes_actions,
        max_writers=max(LEAST_WRITERS, 2 * (_sources(model) + most_sources)),
        max_ages=max_ages_of(config),
        mapped=mapped_sources(config),
        publisher_ids=publisher_ids(config),
    )
    for each in further:
        subscriber.add_connection(
            each.envelope, barred=each.barred, relayed=each.relayed, takes_actions=each.takes_actions
        )
    state = FleetState(
        model, counters, unknown_sources=config.server.unknown_sources, max_discovered_sources=most_sources
    )
    subscriber.caught = state.caught = mistakes.caught
    application, most_bytes = server_application(config), ends.envelopes.max_plain_bytes
    return Ground(
        publisher=Publisher(
            SERVER_SPACE,
            timing,
            counters,
            codec,
            application,
            max_packed_bytes=most_bytes,
            settings=writer_settings(config),
            timestamps=Timestamps(only_increase=True),
        ),
        subscriber=subscriber,
        counters=counters,
        commands=Commands(model),
        state=state,
        skills=SkillCommands(
            journal,
            send=ends.sender.send,
            want=subscriber.want_action,
            sooner=sooner,
            wall_ticks=wall_ticks,
            must_be_verified=ends.connections.must_be_verified,
            told=told,
            clock=clock,
            log=_log,
        ),
        tracker=SkillTracker(model),
        mistakes=mistakes,
        log=_log,
        send=ends.sender.send,
    )


def _sources(model: FleetModel) -> int:
    """Data sources that are configured."""
    return len(model.bridges) + sum(1 for robot in model.robots for _ in robot.all_data_sets())
