"""The feeds that a page can want, by their names."""

from typing import Final

from ua_fleet.console.feeds.kinds import FeedKind
from ua_fleet.console.feeds.robot import ROBOT
from ua_fleet.console.feeds.robots import ROBOTS

__all__ = ["FEEDS"]

FEEDS: Final[dict[str, FeedKind]] = {kind.name: kind for kind in (ROBOTS, ROBOT)}
