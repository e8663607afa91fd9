"""Mode and judgements as operators have set them by Methods, over restarts of the server.

`fleet.yaml` has the first ones. What was set later counts, until `fleet.yaml` itself says something else than it did
when it was set: of two changes the later one counts, whichever way it was made.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, NamedTuple

from ua_fleet.errors import UaFleetError
from ua_fleet.operation.log import Log
from ua_fleet.operation.runs.decision_judgements import DECISION_PREFIX
from ua_fleet.orchestrator import ResilienceSettings
from ua_fleet.resilience import DecisionMode, OnLimit
from ua_fleet.storage.run_journal import RunJournal, StoredSetting

__all__ = ["KeptSettings"]


class _Part(NamedTuple):
    """Settings that are changed together: as a text, and put back."""

    text: Callable[[ResilienceSettings], str]
    put: Callable[[ResilienceSettings, Any], ResilienceSettings]


def _mode_text(settings: ResilienceSettings) -> str:
    return json.dumps({"mode": settings.mode, "limit_s": settings.limit_s, "on_limit": settings.on_limit})


def _put_mode(settings: ResilienceSettings, stored: Any) -> ResilienceSettings:
    return replace(
        settings,
        mode=DecisionMode(stored["mode"]),
        limit_s=float(stored["limit_s"]),
        on_limit=OnLimit(stored["on_limit"]),
    )


def _judgements_text(settings: ResilienceSettings) -> str:
    judgements = sorted([one, other, float(value)] for (one, other), value in settings.judgements.items())
    return json.dumps({"criteria": sorted(one.name for one, _ in settings.criteria), "judgements": judgements})


def _put_judgements(settings: ResilienceSettings, stored: Any) -> ResilienceSettings:
    return replace(settings, judgements={(one, other): float(value) for one, other, value in stored["judgements"]})


_PARTS: Final = {"mode": _Part(_mode_text, _put_mode), "judgements": _Part(_judgements_text, _put_judgements)}


class KeptSettings:
    """What counts now, and what of it is kept in the journal."""

    def __init__(self, configured: ResilienceSettings, journal: RunJournal, log: Log) -> None:
        """Take what the journal has kept.

        Args:
            configured: what `fleet.yaml` says.
            journal: keeps the rest.
            log: is told what counts of it.

        Raises:
            StorageUnavailable: the journal cannot be read.
        """
        self._configured, self._journal, self._log = configured, journal, log
        self.current = configured
        for name, stored in journal.settings().items():
            if not name.startswith(DECISION_PREFIX):
                self._restore(name, stored)

    def _restore(self, name: str, stored: StoredSetting) -> None:
        part = _PARTS.get(name)
        if part is None or part.text(self._configured) != stored.instead_of:
            reason = "fleet.yaml says something else than it did then"
        else:
            try:
                self.current = part.put(self.current, json.loads(stored.value))
            except (UaFleetError, ValueError, KeyError, TypeError) as error:
                reason = f"it cannot be read: {error}"
            else:
                self._log.info(
                    "set by a user, in place of what fleet.yaml says", what=name, by=stored.by, value=stored.value
                )
                return
        self._log.warning("what a user has set does not count any more", what=name, by=stored.by, reason=reason)
        self._journal.forget_setting(name)

    def keep(self, settings: ResilienceSettings, by: str, at: float) -> None:
        """From now on these count. Nothing has changed where StorageUnavailable is raised."""
        for name, part in _PARTS.items():
            text, configured = part.text(settings), part.text(self._configured)
            if text == configured:
                self._journal.forget_setting(name)
            elif text != part.text(self.current):
                self._journal.keep_setting(name, StoredSetting(text, configured, by, at))
        self.current = settings
