"""The console's figures for Prometheus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ua_fleet.console.app import ConsoleApp
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.people import People
from ua_fleet.monitoring.metrics import CONSOLE_LINKS, CONSOLE_PAGES, CONSOLE_REFUSED, CONSOLE_SESSIONS, Family

__all__ = ["console_figures"]

_STATES = ("connecting", "live", "away", "ended")


def console_figures(people: People, app: ConsoleApp, counts: ConsoleCounts) -> Iterator[Family]:
    """Who is there, and what was refused."""
    yield CONSOLE_SESSIONS.one(len(people.sessions))
    yield CONSOLE_PAGES.one(app.sockets)
    states = Counter(link.state for link in people.links)
    yield CONSOLE_LINKS.many(((state,), states[state]) for state in _STATES)
    yield CONSOLE_REFUSED.many(((cause,), count) for cause, count in counts.drops.items())
