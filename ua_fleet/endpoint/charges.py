"""Who pays for what a connection costs before it has a user: its address, or the gateway that it belongs to.

A gateway's connection is one once it has proved so, by a message that only the owner of the certificate can have made.
Until then its address pays. Where the address can pay no more, and a gateway is connected from there now, others are
heard until they show their certificate, and a reserve pays for those that show a gateway's. Time is an argument.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

from ua_fleet.endpoint.origin import origin
from ua_fleet.endpoint.strangers import StrangersTime

__all__ = ["REFUSED_LOGIN_S", "Charge", "Charges"]

GATEWAY_AT_ONCE_S: Final = 4.0
"""Seconds of computing that logins through one gateway may cost at once: some 700 that fail."""
GATEWAY_SHARE: Final = 0.25
"""Part of a core that they may cost in the long run."""
TRIAL_SHARE: Final = 0.25
"""Part of a core that may be spent beside a gateway, by address, on hearing who shows which certificate, and on
telling endpoints, for which most clients ask before. It takes no private key."""
RESERVE_SHARE: Final = 0.1
"""Part of a core that those may cost who show a gateway's, until they have proved that it is theirs, by address."""
LOGIN_S: Final = 0.05
"""What one connection of a gateway may cost beyond that, so that a login that has begun is done."""
REFUSED_LOGIN_S: Final = 0.002
"""What it takes to look at a login through a gateway that is refused, but for its password check in the background."""


class Charges:
    """The budgets of all, and from where gateways are connected."""

    def __init__(self) -> None:
        self.strangers = StrangersTime()
        self.trial, self.reserve = StrangersTime(share=TRIAL_SHARE), StrangersTime(share=RESERVE_SHARE)
        self.gateways = StrangersTime(GATEWAY_AT_ONCE_S, GATEWAY_SHARE)
        """By name of the gateway."""
        self._connected: Counter[str] = Counter()

    def has_gateway(self, address: str) -> bool:
        """Whether a gateway is connected from an address now."""
        return origin(address) in self._connected

    def connected(self, address: str) -> None:
        """A connection has proved to be a gateway's."""
        self._connected[origin(address)] += 1

    def disconnected(self, address: str) -> None:
        """A connection of a gateway is gone, or is one no more."""
        counts_as = origin(address)
        self._connected[counts_as] -= 1
        if self._connected[counts_as] <= 0:
            del self._connected[counts_as]

    def is_exhausted(self, address: str, now: float) -> bool:
        """Whether nothing more is done for clients of this address that have no user."""
        return self.strangers.exhausted(address, now) and (
            not self.has_gateway(address) or self.trial.exhausted(address, now)
        )


class Charge:
    """What one connection owes."""

    def __init__(self, charges: Charges, address: str) -> None:
        self._charges, self._address = charges, address
        self._budget, self._payer = charges.strangers, address
        self._owed_s = 0.0
        """Computing time of this connection since it has no user."""
        self._is_over = False
        self.gateway = ""
        """Name of the gateway whose connection this has proved to be."""

    @property
    def is_on_trial(self) -> bool:
        """Whether it goes on only with the certificate of a gateway, which it has not shown yet."""
        return self._budget is self._charges.trial

    def is_exhausted(self, now: float, shown: Callable[[], bool | None]) -> bool:
        """Whether nothing more is done for the connection.

        Args:
            now: the time.
            shown: tells whether the client has shown a gateway's certificate; None while it need not.
        """
        if self.gateway and self._owed_s < LOGIN_S:
            return False
        if not self.is_on_trial and not self._budget.exhausted(self._payer, now):
            return False
        charges = self._charges
        if self._budget is charges.strangers and not charges.has_gateway(self._address):
            return True
        if self._budget not in (charges.strangers, charges.trial) or (is_gateways := shown()) is False:
            return True
        # What it has cost its address stays there: or strangers would be forgiven by whoever comes after them.
        self._budget, self._owed_s = charges.trial if is_gateways is None else charges.reserve, 0.0
        return self._budget.exhausted(self._address, now)

    def spend(self, seconds: float, now: float) -> None:
        """It has cost this, without a user."""
        self._owed_s += seconds
        self._budget.spend(self._payer, seconds, now)

    def repay(self) -> None:
        """A user has logged in: what it cost until then is owed no more."""
        self._budget.repay(self._payer, self._owed_s)
        self._owed_s = 0.0

    def belongs_to(self, gateway: str, now: float) -> bool:
        """It has proved to be this gateway's, or, without a name, is none any more; False where it can pay no more."""
        if gateway == self.gateway or self._is_over:
            return True
        if not self.gateway:
            self._charges.connected(self._address)
        elif not gateway:
            self._charges.disconnected(self._address)
        self.gateway = gateway
        if not gateway:
            self._move(self._charges.strangers, self._address, now)
            return True
        has_left = not self._charges.gateways.exhausted(gateway, now)
        self._move(self._charges.gateways, gateway, now)
        return has_left

    def end(self) -> None:
        """The connection is gone, whatever is asked of it later; what it owes stays owed."""
        self._is_over = True
        if self.gateway:
            self._charges.disconnected(self._address)
            self.gateway = ""

    def _move(self, budget: StrangersTime, payer: str, now: float) -> None:
        self._budget.repay(self._payer, self._owed_s)
        self._budget, self._payer = budget, payer
        budget.spend(payer, self._owed_s, now)
