"""How many lines of one kind somebody may put into the audit log; what is beyond is counted and summed up.

Refusals, logins and logouts cost their maker nothing, and what operators change can be repeated for ever. Each user, or
each address without a user, has an allowance of them: so many at once, and so many a minute in the long run. All
strangers together have one more, since one may have many addresses. What is beyond makes one line a minute that says
how many of what there were, so nothing is lost in silence and nobody pushes older lines out of the files. Time is an
argument.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from ua_fleet.endpoint.audit.caller import Caller
from ua_fleet.rate import Budget

__all__ = ["AT_ONCE", "A_MINUTE", "Allowances", "Omitted"]

AT_ONCE: Final = 120
A_MINUTE: Final = 12
SUM_EACH_S: Final = 60.0
MAX_NAMES: Final = 1_000
MAX_KINDS: Final = 30
"""Kinds that are told apart in one sum."""
SUM_AT_LOGOUT_S: Final = 5.0
"""Age from which a sum is told when its user logs out, also where there is no room for the line of the logout."""


@dataclass(frozen=True, slots=True)
class Share:
    """How many lines one has: so many at once, and so many a minute in the long run."""

    at_once: int
    a_minute: int

    def budget(self) -> Budget:
        """All of it."""
        return Budget(self.a_minute / 60, self.at_once)


FREE: Final = Share(AT_ONCE, A_MINUTE)
"""Of what costs its maker nothing."""
CHANGES: Final = Share(3_000, 120)
"""Of what operators and engineers change: 40 MB a day, where a loop of writes filled all files in half a minute."""
STRANGERS: Final = Share(600, 60)
"""Of all who have no user, together."""


@dataclass(slots=True)
class Omitted:
    """What was left out, for one who had too much of it."""

    caller: Caller
    """Who, as far as all of it has that in common."""
    since: float
    kinds: Counter[str] = field(default_factory=Counter[str])
    last: dict[str, str] = field(default_factory=dict[str, str])
    """The last value of each kind, where it has one."""


@dataclass(slots=True)
class _Account:
    budget: Budget
    omitted: Omitted | None = None


class Allowances:
    """The allowances of all, for lines of one sort."""

    def __init__(self, share: Share = FREE) -> None:
        self._share = share
        self._accounts: dict[str, _Account] = {}
        self._addresses: OrderedDict[str, None] = OrderedDict()
        """Those of the accounts that are addresses. New ones push out the oldest of these, and never a user: there are
        as many as there are users, and one whose account is forgotten would have a new allowance. An address gains
        nothing by that, since all addresses have one more together."""
        self._last: tuple[Caller, _Account] | None = None
        """Whose user's account was asked for last: the lines of a request are of one caller."""
        self._strangers = STRANGERS.budget()
        self._pushed_out: list[Omitted] = []

    def take(self, caller: Caller, kind: str, now: float, value: str = "") -> bool:
        """Whether a line of this kind may be written; otherwise it is counted for the next sum, with its last value."""
        if caller.is_stranger:
            account = self._address(caller.counts_as)
            if now >= account.budget.at() and self._strangers.take(now):
                account.budget.spend(now)
                return True
        else:
            account = self._user(caller)
            if account.budget.take(now):
                return True
        omitted = account.omitted
        if omitted is None:
            shown = Caller(caller.counts_as) if caller.is_stranger else Caller(caller.client, caller.user, caller.role)
            omitted = account.omitted = Omitted(shown, now)
        kind = kind if kind in omitted.kinds or len(omitted.kinds) < MAX_KINDS else "other"
        omitted.kinds[kind] += 1
        if value:
            omitted.last[kind] = value
        return False

    def _user(self, caller: Caller) -> _Account:
        """The account of a user, which is never forgotten."""
        if self._last is not None and self._last[0] is caller:
            return self._last[1]
        name = caller.counts_as
        account = self._accounts.get(name)
        if account is None:
            account = self._accounts[name] = _Account(self._share.budget())
        self._last = caller, account
        return account

    def _address(self, name: str) -> _Account:
        account = self._accounts.get(name)
        if account is None:
            account = self._accounts[name] = _Account(self._share.budget())
            self._addresses[name] = None
            self._push_out()
        self._addresses.move_to_end(name)
        return account

    def _push_out(self) -> None:
        while len(self._addresses) > MAX_NAMES:
            name, _ = self._addresses.popitem(last=False)
            omitted = self._accounts.pop(name).omitted
            if omitted is not None:
                self._pushed_out.append(omitted)

    def sums(self, now: float, *, of: Caller | None = None, least_s: float = 0.0) -> Iterator[Omitted]:
        """The sums that are due; with `of` that user's or address's, as soon as it is `least_s` old."""
        pushed_out, self._pushed_out = self._pushed_out, []
        yield from _merged(pushed_out)
        strangers: list[Omitted] = []
        for name, account in self._accounts.items():
            omitted = account.omitted
            wanted = name == of.counts_as if of is not None else True
            if omitted is None or not wanted or now - omitted.since < (SUM_EACH_S if of is None else least_s):
                continue
            account.omitted = None
            if omitted.caller.user:
                yield omitted
            else:
                strangers.append(omitted)
        yield from _merged(strangers)

    def all_sums(self) -> Iterator[Omitted]:
        """All sums, due or not."""
        return self.sums(float("inf"))


def _merged(sums: list[Omitted]) -> Iterator[Omitted]:
    """Sums of a few strangers each by itself; those of many addresses as one, or their number would be the flood."""
    if len(sums) <= MAX_SINGLE:
        yield from sums
        return
    total = Counter[str]()
    for each in sums:
        total.update(each.kinds)
    yield Omitted(Caller(f"{len(sums)} addresses"), min(each.since for each in sums), total)


MAX_SINGLE: Final = 10
