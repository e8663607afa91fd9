"""Which SecurityGroup a message belongs to. This is the only place that knows how groups are named.

Each publishing process has two (OPC 10000-14 6.2.12): `t-<PublisherId>` for what it publishes to all, and
`c-<PublisherId>` for Actions, requests and responses alike, and for the server's setpoints for that process's robots,
whose keys only it and its permitted requestors have. All WriterGroups of a publisher share them: they run in one
process, which has one key for each purpose. SecurityTokenIds are not unique over groups, so a key is never chosen by
its token alone.

A relay has one, `r-<name>`, for what it forwards. A process that hears a publisher by a relay on a connection takes
that group's key in place of the publisher's own there, and no other.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator
from typing import Final

from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub.security.keyring import Keyring
from ua_fleet.pubsub.security.nonces import NonceSequence

__all__ = ["MOST_KEYLESS", "Group", "KeyGroups", "command_group", "is_group", "relay_group", "telemetry_group"]

MOST_KEYLESS: Final = 256
"""Publishers that were heard and of which we have no key. Anybody can write any PublisherId."""

_GROUP_ID: Final = re.compile(r"([tc])-(0|[1-9]\d{0,4})|r-[A-Za-z][A-Za-z0-9_-]{0,61}", re.ASCII)


def telemetry_group(publisher_id: int) -> str:
    """The group of the data and announcements of a publisher."""
    return f"t-{publisher_id}"


def command_group(publisher_id: int) -> str:
    """The group of the Actions of a responder, and of the setpoints for its robots."""
    return f"c-{publisher_id}"


def relay_group(name: str) -> str:
    """The group of what a relay forwards."""
    return f"r-{name}"


def is_group(group_id: str) -> bool:
    """Whether this is the name of a SecurityGroup."""
    found = _GROUP_ID.fullmatch(group_id)
    return found is not None and int(found[2] or 0) <= 0xFFFF


class Group:
    """One SecurityGroup as this process has it."""

    __slots__ = ("group_id", "is_relaxed", "keyring", "sequence")

    def __init__(self, group_id: str, past_keys: int, *, is_relaxed: bool) -> None:
        self.group_id = group_id
        self.keyring = Keyring(group_id, past_keys)
        self.is_relaxed = is_relaxed
        """Whether nonces that were used before are taken (`relaxed_replay`)."""
        self.sequence: NonceSequence | None = None
        """The nonces of the token that was last used to send."""


class KeyGroups:
    """All groups that this process wants keys of: those it was told to want, and perhaps of publishers it hears.

    Groups of Actions are wanted only when told: a bystander hears the Actions of others and may not have their keys.
    """

    def __init__(self, past_keys: int, relaxed: Container[int], *, takes_all: bool = False) -> None:
        """Begin with none.

        Args:
            past_keys: KeyLifetimes for which readers take a key that was replaced.
            relaxed: PublisherIds whose data is not checked for replay.
            takes_all: whether the data of publishers that are only heard has groups, too.
        """
        self._takes_all = takes_all
        self.telemetry: dict[int | str | None, Group] = {}
        """By PublisherId."""
        self.commands: dict[int, Group] = {}
        """By the PublisherId of the responder."""
        self._by_id: dict[str, Group] = {}
        self._keyless: dict[int, None] = {}
        """Publishers that were only heard, and whose keys nobody gave us yet."""
        self._past_keys, self._relaxed = past_keys, relaxed

    def __iter__(self) -> Iterator[Group]:
        return iter(self._by_id.values())

    def get(self, group_id: str) -> Group | None:
        """The group of this name; None where it is not wanted."""
        return self._by_id.get(group_id)

    def want(self, group_id: str) -> Group:
        """The group of this name, from now on among the wanted ones; raises LocalWireError for what is no name."""
        if not is_group(group_id):
            raise LocalWireError(
                f"{group_id!r} is no SecurityGroup: they are called t-<space>, c-<space> and r-<relay>"
            )
        kind, _, rest = group_id.partition("-")
        publisher_id = None if kind == "r" else int(rest)
        group = self._by_id.get(group_id)
        if group is None:
            # A peer that cannot count its nonces may send data so; commands are never taken a second time.
            is_relaxed = kind == "t" and publisher_id is not None and publisher_id in self._relaxed
            group = self._by_id[group_id] = Group(group_id, self._past_keys, is_relaxed=is_relaxed)
            if kind == "t":
                self.telemetry.setdefault(publisher_id, group)  # unless a relay speaks for it
            elif publisher_id is not None:
                self.commands[publisher_id] = group
        if kind == "t" and publisher_id is not None:
            self._keyless.pop(publisher_id, None)
        return group

    def entrust(self, publisher_id: int, group_id: str) -> None:
        """Take the data of a publisher under another group's keys, and no more under its own."""
        self.telemetry[publisher_id] = self.want(group_id)

    def hear(self, publisher_id: int) -> Group | None:
        """The group of the data of a publisher that was heard, if it may have one.

        The longest known without a key goes for it.
        """
        if not self._takes_all:
            return None
        if len(self._keyless) >= MOST_KEYLESS:  # none of them is one that a relay speaks for: that has a group
            oldest = next(iter(self._keyless))
            del self._keyless[oldest], self.telemetry[oldest], self._by_id[telemetry_group(oldest)]
        group = self.want(telemetry_group(publisher_id))
        self._keyless[publisher_id] = None
        return group
