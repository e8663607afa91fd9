"""The topics that a ROS 2 bridge listens to: each is guarded by itself, bounded, and forgotten when it is gone.

All of it runs in the node's thread, which also takes in every robot's messages. So new topics are followed a few at a
time, however many come at once, and a topic that makes the bridge fail is put aside.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from typing import Final, Protocol

import structlog

from ua_bridges.ros2.graph import GraphWatch, Publisher, PublishersChanged
from ua_fleet.bridge.driver import Inlet, SourceForgotten
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.topics import Topic

__all__ = ["Source", "Sources"]

FOLLOW_S: Final = 0.015
"""Of each look, for topics that are new or have changed; at least one is followed."""
FORGET_S: Final = 60.0
"""A topic of the own space that nobody publishes for so long is forgotten."""
MOST_GONE: Final = 100
"""Topics that nobody publishes and that are kept, since their publishers may return; then the oldest goes at once."""

_log = structlog.get_logger("ua_bridges.ros2")


class Source(Protocol):
    """What is done with a topic; see `ua_bridges.ros2.source.RosSource`."""

    @property
    def offence(self) -> str | None:
        """What it does that no robot should, or None."""
        ...

    def follow(self, publishers: Sequence[Publisher]) -> None:
        """Take note of its publishers."""
        ...

    def looked(self) -> None:
        """The graph was looked at."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class Sources:
    """The sources by the names of their topics."""

    def __init__(
        self,
        fixed: Collection[str],
        make: Callable[[str], Source],
        graph: GraphWatch,
        inlet: Inlet,
        offenders: Offenders,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin without sources.

        Args:
            fixed: full names of topics that `fleet.yaml` names, which are never forgotten.
            make: makes the source of a topic.
            graph: told what is forgotten, or looked at again.
            inlet: told what is forgotten.
            offenders: the topics that are put aside.
            clock: gives seconds of a monotonic clock.
        """
        self._fixed, self._make, self._graph, self._inlet, self._offenders = fixed, make, graph, inlet, offenders
        self._clock = clock
        self._sources: dict[str, Source] = {}
        self._changes: dict[str, PublishersChanged] = {}
        """What is still to be followed: the newest change of each topic."""
        self._gone: dict[str, float] = {}
        """Since when nobody publishes a topic that was published, the oldest first."""
        self._aside: set[str] = set()

    def open(self) -> None:
        """Make the sources of the topics that `fleet.yaml` names."""
        for name in self._fixed:
            self._sources[name] = self._make(name)

    def changed(self, change: PublishersChanged) -> None:
        """A topic has other publishers than before."""
        self._changes[change.topic_name] = change

    def look(self) -> bool:
        """Follow what has changed, let go of what is gone; whether there is more to follow."""
        now = self._clock()
        for name in [each for each in self._aside if not self._offenders.is_aside(each, now)]:
            self._aside.discard(name)
            self._graph.look_again(name)
            self._gone.setdefault(name, now)  # until its publishers are told: they may have left meanwhile
        until = now + FOLLOW_S
        # Those that are known go first: many new ones must not keep a robot from being missed, or from returning.
        for name in sorted(self._changes, key=lambda each: each not in self._sources):
            self._follow(self._changes.pop(name))
            if self._clock() >= until:
                break
        for name, source in list(self._sources.items()):
            if name not in self._changes:
                self._guarded(name, source.looked)
            if source.offence is not None:
                self._put_aside(name, source.offence)
        self._forget(now)
        return bool(self._changes)

    def close(self) -> None:
        """End all of them."""
        for name, source in self._sources.items():
            self._guarded(name, source.close, puts_aside=False)

    def _follow(self, change: PublishersChanged) -> None:
        name = change.topic_name
        if name in self._aside:
            return  # it is looked at again when its time is over
        source = self._sources.get(name)
        if source is None:
            source = self._sources[name] = self._make(name)
        if change.publishers:
            self._gone.pop(name, None)
        else:
            self._gone.setdefault(name, self._clock())
        self._guarded(name, lambda: source.follow(change.publishers))

    def _guarded(self, name: str, work: Callable[[], None], *, puts_aside: bool = True) -> None:
        try:
            work()
        except Exception as error:  # noqa: BLE001 - one topic, one mistake
            self._failed(name, error, puts_aside=puts_aside)

    def _failed(self, name: str, error: Exception, *, puts_aside: bool = True) -> None:
        _log.error("a topic made the bridge fail", topic=name, exc_info=error)
        if puts_aside:
            said = " ".join(str(error).split()) or type(error).__name__
            self._put_aside(name, f"the bridge cannot follow it: {said}")

    def _put_aside(self, name: str, reason: str) -> None:
        self._offenders.put_aside(name, reason, self._clock())
        self._aside.add(name)
        source = self._sources.pop(name, None)
        self._gone.pop(name, None)
        if source is not None:
            self._guarded(name, source.close, puts_aside=False)
        if name in self._fixed:
            self._sources[name] = self._make(name)

    def _forget(self, now: float) -> None:
        for name, since in list(self._gone.items()):
            if now < since + FORGET_S and len(self._gone) <= MOST_GONE:
                break
            del self._gone[name]
            if name in self._fixed:
                continue
            source = self._sources.pop(name, None)
            if source is not None:
                self._guarded(name, source.close, puts_aside=False)
            self._graph.forget(name)
            self._inlet.put(SourceForgotten(Topic.parse(name[1:])))
