"""How often one bridge may ask for keys: pure, time is an argument."""

from __future__ import annotations

from typing import Final

from ua_fleet.rate import Budget

__all__ = ["CallLimit"]

LEAST_BURST: Final = 120
LEAST_PER_SECOND: Final = 2.0


class CallLimit:
    """A budget for each caller; as many callers as there are bridges.

    A bridge asks for each group at its start, and then at half of the KeyLifetime (OPC 10000-14 8.3.2); it may do so
    four times as often. So a bridge that has gone astray can neither keep the server busy nor push older lines out of
    the audit log.
    """

    def __init__(self, groups: int, lifetime_s: float) -> None:
        self._burst = float(max(LEAST_BURST, 4 * groups))
        self._per_second = max(LEAST_PER_SECOND, 8 * groups / lifetime_s)
        self._budgets: dict[str, Budget] = {}

    def take(self, caller: str, now: float) -> bool:
        """Whether a caller may ask once more now."""
        budget = self._budgets.get(caller)
        if budget is None:
            budget = self._budgets[caller] = Budget(self._per_second, self._burst)
        return budget.take(now)
