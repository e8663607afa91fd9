"""Judgements of single decisions as operators have set them, over restarts of the server, until a decision is over."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import replace
from typing import Final

from ua_fleet.errors import UaFleetError
from ua_fleet.operation.log import Log
from ua_fleet.orchestrator import DecisionChanged, ResilienceSettings
from ua_fleet.resilience import Judgements, RankingChanged
from ua_fleet.storage.run_journal import RunJournal, StoredSetting

__all__ = ["DECISION_PREFIX", "DecisionJudgements"]

DECISION_PREFIX: Final = "decision "
"""Before the id of a decision, in the names of settings."""


class DecisionJudgements:
    """What the journal keeps of them. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, journal: RunJournal, log: Log) -> None:
        self._journal, self._log = journal, log
        self._kept: set[str] = set()

    def restored(self, settings: ResilienceSettings, run_ids: Collection[str]) -> dict[str, Judgements]:
        """Those that were kept, by the ids of decisions.

        Those that do not fit the criteria any more are forgotten, and those of runs that are over: a server that was
        killed may have left them behind.

        Args:
            settings: for all decisions.
            run_ids: of the runs that go on.
        """
        found: dict[str, Judgements] = {}
        for name, stored in self._journal.settings().items():
            if not name.startswith(DECISION_PREFIX):
                continue
            decision_id = name.removeprefix(DECISION_PREFIX)
            self._kept.add(decision_id)
            if decision_id.partition(".")[0] not in run_ids:
                self.forget(decision_id)
                continue
            try:
                judgements = {(one, other): float(value) for one, other, value in json.loads(stored.value)}
                replace(settings, judgements=judgements)
            except (UaFleetError, ValueError, TypeError) as error:
                self._log.warning(
                    "judgements of a decision do not count any more", decision_id=decision_id, reason=str(error)
                )
                self.forget(decision_id)
            else:
                found[decision_id] = judgements
        return found

    def keep(self, decision_id: str, judgements: Judgements, by: str, at: float) -> None:
        """From now on these count for a decision."""
        value = json.dumps([[one, other, float(value)] for (one, other), value in judgements.items()])
        self._journal.keep_setting(f"{DECISION_PREFIX}{decision_id}", StoredSetting(value, "", by, at))
        self._kept.add(decision_id)

    def forget(self, decision_id: str) -> None:
        """Those of all decisions count for this one, or it is over."""
        if decision_id in self._kept:
            self._journal.forget_setting(f"{DECISION_PREFIX}{decision_id}")
            self._kept.discard(decision_id)

    def closed(self, changed: DecisionChanged) -> None:
        """Something has become of a decision; it may be over."""
        if not isinstance(changed.event, RankingChanged):
            self.forget(changed.event.decision_id)
