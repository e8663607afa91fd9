"""Computing time that clients cost before they have a user: each address has a budget of it.

A handshake makes the server use its private key, and whoever asks for one needs neither a key nor a certificate of
value: the bytes of somebody else's can be sent again. So what a connection costs before its user is known is a debt of
its address, which is paid back by the clock, and at once when a user logs in. Behind a router many clients share an
address; as long as they log in, they owe nothing. Time is an argument.

Who has many addresses has them of the same network: networks have budgets too, each a few times that of an address.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.endpoint.origin import networks

__all__ = ["AT_ONCE_S", "SHARE", "StrangersTime"]

AT_ONCE_S: Final = 1.0
"""Seconds of computing that one address may cost at once: some 500 handshakes."""
SHARE: Final = 0.05
"""Part of a core that it may cost in the long run."""
_TIMES_AN_ADDRESS: Final = (1, 4, 16)
"""What an address, its network and its wide network may cost, as multiples."""
_MOST: Final = 4_096
"""Debts that are remembered."""


@dataclass(slots=True)
class _Debt:
    seconds: float
    at: float
    times: int

    share: float
    """Part of a core by which it is paid back."""

    def left(self, now: float) -> float:
        return max(0.0, self.seconds - (now - self.at) * self.share)


class StrangersTime:
    """The debts of all addresses."""

    def __init__(self, at_once_s: float = AT_ONCE_S, share: float = SHARE) -> None:
        """Give each address a budget.

        Args:
            at_once_s: seconds of computing that it may cost at once.
            share: part of a core that it may cost in the long run.
        """
        self._at_once_s, self._share = at_once_s, share
        self._debts: dict[str, _Debt] = {}

    def __len__(self) -> int:
        return len(self._debts)

    def exhausted(self, address: str, now: float) -> bool:
        """Whether nothing more is done for clients of this address that have no user."""
        for name in networks(address):
            debt = self._debts.get(name)
            if debt is None:
                continue
            most = self._at_once_s * debt.times
            if debt.seconds >= most and debt.left(now) >= most:
                return True
        return False

    def owed(self, address: str, now: float) -> float:
        """Seconds that an address by itself owes."""
        debt = self._debts.get(networks(address)[0])
        return debt.left(now) if debt is not None else 0.0

    def spend(self, address: str, seconds: float, now: float) -> None:
        """A client without a user has cost this."""
        for name, times in zip(networks(address), _TIMES_AN_ADDRESS, strict=True):
            debt = self._debts.get(name)
            if debt is None:
                self._debts[name] = _Debt(seconds, now, times, self._share * times)
            else:
                left = debt.seconds - (now - debt.at) * debt.share
                debt.seconds, debt.at = (left if left > 0.0 else 0.0) + seconds, now
        if len(self._debts) > _MOST:
            self._forget(now)

    def repay(self, address: str, seconds: float) -> None:
        """A user has logged in: what it cost until then is owed no more."""
        for name in networks(address):
            if (debt := self._debts.get(name)) is not None:
                debt.seconds = max(0.0, debt.seconds - seconds)

    def _forget(self, now: float) -> None:
        """Forget the half that owe least: new addresses do not make the server forget who owes much."""
        by_debt = sorted(self._debts.items(), key=lambda item: item[1].left(now) / item[1].times, reverse=True)
        self._debts = dict(by_debt[: _MOST // 2])
