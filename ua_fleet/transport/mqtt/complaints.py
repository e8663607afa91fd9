"""Problems with a broker in the log, each once in a minute."""

from __future__ import annotations

from typing import Final

import structlog

__all__ = ["Complaints"]

AGAIN_S: Final = 60.0
_MOST: Final = 100

_log = structlog.get_logger("ua_fleet.transport.mqtt.transport")


class Complaints:
    """What was told of one broker, and when."""

    def __init__(self) -> None:
        self._told: dict[str, float] = {}

    def tell(self, url: str, problem: str, now: float, **details: str) -> None:
        """Log a problem, unless it was told within the last minute."""
        key = f"{problem} {details.get('cause', '')}"
        if now - self._told.get(key, float("-inf")) < AGAIN_S:
            return
        if len(self._told) >= _MOST:
            self._told.clear()
        self._told[key] = now
        _log.warning("problem with the MQTT broker", url=url, problem=problem, **details)

    def forget(self) -> None:
        """Tell all of it again, since it went well meanwhile."""
        self._told.clear()
