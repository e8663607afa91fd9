"""The feeds that a page can want, by their names."""

from typing import Final

from ua_fleet.console.feeds.alarms import ALARMS
from ua_fleet.console.feeds.counts import COUNTS
from ua_fleet.console.feeds.decisions import DECISION, DECISIONS, RESILIENCE
from ua_fleet.console.feeds.events import EVENTS
from ua_fleet.console.feeds.health import HEALTH
from ua_fleet.console.feeds.kinds import FeedKind
from ua_fleet.console.feeds.messages import MESSAGES
from ua_fleet.console.feeds.nodes import NODES
from ua_fleet.console.feeds.positions import POSITIONS_FEED
from ua_fleet.console.feeds.robot import ROBOT
from ua_fleet.console.feeds.robots import ROBOTS
from ua_fleet.console.feeds.runs import LIBRARY, RUN, RUNS
from ua_fleet.console.feeds.teleoperation import TELEOPERATION

__all__ = ["FEEDS"]

_ALL: Final = (
    *(ROBOTS, ROBOT, TELEOPERATION, RUNS, RUN, LIBRARY),
    *(DECISIONS, DECISION, RESILIENCE, ALARMS, COUNTS, EVENTS, HEALTH, MESSAGES, NODES, POSITIONS_FEED),
)
FEEDS: Final[dict[str, FeedKind]] = {kind.name: kind for kind in _ALL}
