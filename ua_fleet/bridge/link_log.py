"""What the log says of a bridge's space: one line when something goes away, one when it comes back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ua_fleet.bridge.driver import DriverStatus

__all__ = ["LinkLog"]

MOST_LINES: Final = 5
"""Sources that have a line of their own at one look; the others are counted."""


class LinkLog:
    """Compares a driver's status with what was said of it before.

    Where several things stand behind the bridge, each has its lines, and the bridge as a whole has none. What has not
    come yet when the bridge begins has a line only if it is still not there at the second look.
    """

    def __init__(self, log: Any) -> None:
        """Begin with nothing said; `log` is a logger of structlog."""
        self._log = log
        self._has_looked = False
        self._connected: bool | None = None
        self._there: dict[str, bool] = {}
        """What was said of each device."""
        self._aside: frozenset[str] = frozenset()
        """The sources that were said to be put aside."""

    def take(self, status: DriverStatus) -> None:
        """Say what has changed."""
        self._take_aside(status.aside)
        is_first, self._has_looked = not self._has_looked, True
        if not status.devices:
            if status.connected is not self._connected and (status.connected or not is_first):
                self._connected = status.connected
                if status.connected:
                    self._log.info("connected to the space", detail=status.detail)
                else:
                    self._log.warning("not connected to the space", detail=status.detail)
            return
        for name, reason in status.devices.items():
            if self._there.get(name) is not (not reason) and not (reason and is_first):
                self._there[name] = not reason
                if reason:
                    self._log.warning("device does not answer", device=name, reason=reason)
                else:
                    self._log.info("device answers again", device=name)

    def _take_aside(self, aside: Mapping[str, str]) -> None:
        names = frozenset(aside)
        if names == self._aside:
            return
        came, went, self._aside = sorted(names - self._aside), sorted(self._aside - names), names
        for name in came[:MOST_LINES]:
            self._log.warning("source is put aside", source=name, reason=aside[name])
        for name in went[:MOST_LINES]:
            self._log.info("source is gone, or sends valid data again", source=name)
        if (others := max(0, len(came) - MOST_LINES)) or len(went) > MOST_LINES:
            self._log.warning("more sources", put_aside=others, gone_or_behave=max(0, len(went) - MOST_LINES))
