"""What is attached to the hub: parts of the server that hear what comes by PubSub, or have to be called in time."""

from __future__ import annotations

from typing import Protocol

from ua_fleet.pubsub.events import ActionReceived, SubscriberEvent
from ua_fleet.topics import Topic
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["Announced", "Clock", "TeleoperationPart", "TimedPart"]


class Announced(Protocol):
    """Who is told of robots that bridges announce; see `server.robots.roster.Roster`."""

    def announced(self, topic: Topic, text: str) -> None:
        """A bridge says in the metadata of a robot's SkillStatus what the robot is."""
        ...

    def tick(self) -> None:
        """A second has passed."""
        ...


class Clock(Protocol):
    """What has to be called in time."""

    def poll(self) -> None:
        """Do what is due."""
        ...

    def due_in_s(self) -> float | None:
        """After how many seconds `poll` is to be called next, or None."""
        ...


class TimedPart(Protocol):
    """What has to be called in time, by the clock of the event loop."""

    def poll(self, now: float) -> None:
        """Do what is due."""
        ...

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next, or None."""
        ...


class TeleoperationPart(Protocol):
    """Robots that are driven by hand; see `server.teleoperation.service`."""

    def begin(self) -> None:
        """Ask for the Actions that are not announced yet."""
        ...

    def follow(self, event: SubscriberEvent) -> None:
        """Take what bridges say of them."""
        ...

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        ...

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action."""
        ...

    def poll(self, now: float) -> None:
        """Do what is due."""
        ...

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        ...
