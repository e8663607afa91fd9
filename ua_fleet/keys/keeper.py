"""Keeping a process in keys: `keep_keys` asks a KeySource for what the Envelope wants, and goes on while it is away.

Keys are fetched when one is missing, when half of the KeyLifetime is over, as often as the source says (`refresh_s`),
and when it says that they have changed before their time (`generation`). What fails is tried again after a delay that
doubles, spread at random so that the processes of a fleet do not all ask at once. It never grows beyond a quarter of a
KeyLifetime: a source that is back gives everybody half of one to fetch a new key before it counts.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from random import Random
from typing import Any, Final, Protocol

import structlog

from ua_fleet.errors import KeysRefused, UaFleetError
from ua_fleet.keys.source import CURRENT_TOKEN, KeySource
from ua_fleet.monitoring.mistakes import Mistakes, is_cancelled
from ua_fleet.pubsub.security.keyring import GroupKeys

__all__ = ["KeyUser", "KeysKept", "keep_keys"]

PERIOD_S: Final = 0.25
"""How often it is looked at what is wanted."""
FIRST_DELAY_S: Final = 0.5
LONGEST_DELAY_S: Final = 30.0
LONGEST_DELAY_AT_START_S: Final = 5.0
"""The same for a process that never had a key: it stands still until its source is back, so it looks more often."""
LONGEST_ANSWERED_DELAY_S: Final = 60.0
"""Between two fetches of a group that the source has nothing new of, though it is wanted: an unknown token that
anybody can write into a message must not make us ask all the time. What is new meanwhile comes by `generation`."""
OTHERS_S: Final = 2.0
"""Who begins with its own key waits so long for those of others, which the source may be slow with."""

_MOST_TOLD: Final = 64
"""Reasons that the log names before it names them again, and refused groups that it names in `_TOLD_PERIOD_S`: who
writes messages of ever new groups must not fill it."""
_TOLD_PERIOD_S: Final = 3600.0

_log: Any = structlog.get_logger("ua_fleet.keys")


class KeyUser(Protocol):
    """What the keeper needs of an Envelope."""

    @property
    def problem(self) -> str:
        """Why something could not be sent; empty when the last message could."""
        ...

    def groups_wanted(self) -> Iterable[str]:
        """All groups that are needed, those that matter most first."""
        ...

    def keys_wanted(self, now: float) -> Iterable[str]:
        """The groups to fetch now."""
        ...

    def install(self, group_id: str, keys: GroupKeys, now: float) -> None:
        """Take the keys of a group."""
        ...


class KeysKept:
    """What an operator can be told of the keys of a process, and what it waits for at its start."""

    def __init__(self) -> None:
        self.source_problem = ""
        """Why the source cannot be asked; empty while it can."""
        self.refused: dict[str, str] = {}
        """Groups that the source gives nothing of, each with the reason."""
        self.groups: set[str] = set()
        """Groups whose keys were fetched at least once."""
        self._news, self._round_over = asyncio.Event(), asyncio.Event()

    def problem(self) -> str:
        """One line for a status; empty where there is nothing to say."""
        if self.source_problem:
            return f"the key source is not reachable: {self.source_problem}"
        return "; ".join(list(self.refused.values())[:3])

    def arrived(self, group_id: str) -> None:
        """Keys of a group were fetched."""
        if group_id not in self.groups:
            self.groups.add(group_id)
            self._round_over.clear()
            self._news.set()

    def round_over(self) -> None:
        """The source was asked for all that is due, as far as it answers."""
        self._round_over.set()

    async def wait_for(self, group_ids: Iterable[str]) -> None:
        """Wait until keys of all these groups were fetched, and for a moment until the others were asked for too.

        So who begins then does not drop what it hears first, retained metadata above all. For one waiter at a time.
        """
        wanted = set(group_ids)
        while not wanted <= self.groups:
            self._news.clear()
            await self._news.wait()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(OTHERS_S):
                await self._round_over.wait()


@dataclass(slots=True)
class _Group:
    """What is remembered of the fetches of one group."""

    next_at: float = float("-inf")
    refresh_at: float = float("-inf")
    delay_s: float = 0.0
    keys: GroupKeys | None = None


class _Keeper:
    def __init__(
        self, envelope: KeyUser, source: KeySource, kept: KeysKept, count: int, random: Random, mistakes: Mistakes
    ) -> None:
        self._envelope, self._source, self._kept, self._count, self._random = envelope, source, kept, count, random
        self._mistakes = mistakes
        self._groups: dict[str, _Group] = {}
        self._source_delay_s = 0.0
        self._source_at = float("-inf")
        self._generation = source.generation
        self._told: set[str] = set()
        self._refusals_told = 0
        self._refusals_since = float("-inf")

    def tell_what_was_not_sent(self) -> None:
        """Log each reason once. They name groups and tokens, so there may be many over the years."""
        problem = self._envelope.problem
        if problem and problem not in self._told:
            if len(self._told) >= _MOST_TOLD:
                self._told.clear()
            self._told.add(problem)
            _log.warning("not sent", reason=problem)

    async def fetch_what_is_due(self, clock: Callable[[], float]) -> None:
        """Ask the source for each group that is due, unless it is away and was asked a short time ago."""
        now = clock()
        if now < self._source_at:
            return
        if (generation := self._source.generation) != self._generation:
            self._generation = generation
            for group in self._groups.values():
                group.refresh_at = float("-inf")
        wanted = set(self._envelope.keys_wanted(now))
        # In the envelope's order: groups that somebody made up come last, and cannot use up what a service allows.
        known = tuple(self._envelope.groups_wanted())
        self._forget(known)
        has_answered = False
        for group_id in known:
            group = self._groups.setdefault(group_id, _Group())
            if now >= group.refresh_at or (group_id in wanted and now >= group.next_at):
                try:
                    keys = await self._source.fetch(group_id, CURRENT_TOKEN, self._count)
                except KeysRefused as error:
                    self._refused(group_id, group, str(error), clock())
                    has_answered = True
                    continue
                except UaFleetError as error:
                    self._is_away(str(error), clock())
                    return
                except Exception as error:  # it costs this group its turn, and the others nothing
                    if is_cancelled():
                        raise
                    self._failed(group_id, group, error, clock())
                    continue
                try:
                    self._fetched(group_id, group, keys, group_id in wanted, clock())
                except Exception as error:  # noqa: BLE001 - as above
                    self._failed(group_id, group, error, clock())
                has_answered = True
        if has_answered:  # to all that it was asked for
            self._is_back()

    def _forget(self, known: Iterable[str]) -> None:
        for group_id in self._groups.keys() - set(known):
            del self._groups[group_id]
            self._kept.refused.pop(group_id, None)

    def _is_away(self, reason: str, now: float) -> None:
        lifetimes = (group.keys.key_lifetime_s for group in self._groups.values() if group.keys is not None)
        longest_s = LONGEST_DELAY_S if self._kept.groups else LONGEST_DELAY_AT_START_S
        longest_s = max(FIRST_DELAY_S, min(longest_s, min(lifetimes, default=math.inf) / 4))
        self._source_delay_s = min(longest_s, max(FIRST_DELAY_S, 2 * self._source_delay_s))
        self._source_at = now + self._spread(self._source_delay_s)
        if not self._kept.source_problem:
            _log.warning("the key source is not reachable; known keys stay in use", reason=reason)
        self._kept.source_problem = reason

    def _is_back(self) -> None:
        self._source_delay_s = 0.0
        if self._kept.source_problem:
            _log.info("the key source is reachable again")
            self._kept.source_problem = ""

    def _refused(self, group_id: str, group: _Group, reason: str, now: float) -> None:
        if self._kept.refused.get(group_id) != reason and self._may_tell_refusal(now):
            _log.warning("no keys", group=group_id, reason=reason)
        self._kept.refused[group_id] = reason
        group.refresh_at = self._put_off(group, LONGEST_DELAY_S, now)
        group.keys = None

    def _failed(self, group_id: str, group: _Group, error: Exception, now: float) -> None:
        self._mistakes.caught("keys", error, group=group_id)
        group.refresh_at = self._put_off(group, LONGEST_DELAY_S, now)

    def _may_tell_refusal(self, now: float) -> bool:
        if now >= self._refusals_since + _TOLD_PERIOD_S:
            self._refusals_told, self._refusals_since = 0, now
        self._refusals_told += 1
        return self._refusals_told <= _MOST_TOLD

    def _fetched(self, group_id: str, group: _Group, keys: GroupKeys, is_wanted: bool, now: float) -> None:
        if self._kept.refused.pop(group_id, None) is not None:
            _log.info("keys are there again", group=group_id)
        group.refresh_at = now + self._source.refresh_s
        before, group.keys = group.keys, keys
        is_new = before is None or before[:3] != keys[:3]
        if is_new or is_wanted:
            self._envelope.install(group_id, keys, now)
        if is_new:
            group.delay_s = 0.0
            _log.info("keys", group=group_id, first_token=keys.first_token_id, count=len(keys.keys))
        if is_wanted:
            self._put_off(group, LONGEST_ANSWERED_DELAY_S, now)
        self._kept.arrived(group_id)

    def _put_off(self, group: _Group, longest_s: float, now: float) -> float:
        group.delay_s = min(
            longest_s, max(FIRST_DELAY_S, 2 * group.delay_s), max(FIRST_DELAY_S, self._source.refresh_s)
        )
        group.next_at = now + self._spread(group.delay_s)
        return group.next_at

    def _spread(self, delay_s: float) -> float:
        return delay_s * self._random.uniform(0.5, 1.0)


async def keep_keys(
    envelope: KeyUser,
    source: KeySource,
    kept: KeysKept,
    *,
    count: int,
    random: Random | None = None,
    clock: Callable[[], float] | None = None,
    sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    mistakes: Mistakes | None = None,
) -> None:
    """Keep an Envelope in keys until cancelled.

    Args:
        envelope: says which groups it needs, and takes their keys.
        source: is asked for them.
        kept: told how it goes.
        count: keys to ask for, the current one and future ones.
        random: spreads the delays.
        clock: the time that the envelope goes by; the event loop's if left out.
        sleep: belongs to the clock.
        mistakes: counts what has cost a group its turn; its own without.
    """
    clock = clock or asyncio.get_running_loop().time
    spread = random or Random()  # noqa: S311 - spreads delays, keeps no secret
    keeper = _Keeper(envelope, source, kept, count, spread, mistakes or Mistakes())
    task = asyncio.current_task()
    assert task is not None
    while True:
        await keeper.fetch_what_is_due(clock)
        kept.round_over()
        if task.cancelling():
            # A connection that fails in the moment of the cancellation swallows it (asyncio.wait_for before 3.12).
            raise asyncio.CancelledError
        keeper.tell_what_was_not_sent()
        await sleep(PERIOD_S)
