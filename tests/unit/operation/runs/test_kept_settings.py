"""What users have set, over restarts and changes of `fleet.yaml`."""

from __future__ import annotations

import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import structlog

from ua_fleet.config.resilience_schema import ResilienceConfig
from ua_fleet.errors import StorageUnavailable
from ua_fleet.operation.runs.kept_settings import KeptSettings
from ua_fleet.orchestrator import ResilienceSettings
from ua_fleet.resilience import DecisionMode, OnLimit
from ua_fleet.storage.run_journal import RunJournal, StoredSetting

CRITERIA: dict[str, dict[str, Any]] = {
    "availability": {"kind": "benefit", "range": [0, 100], "tasks_ahead": True},
    "battery": {"kind": "benefit", "range": [0, 100], "value": "battery"},
}


def configured(**changed: Any) -> ResilienceSettings:
    """What a `fleet.yaml` says."""
    given = {"criteria": CRITERIA, "judgements": {"battery": {"availability": 2}}, **changed}
    return ResilienceConfig.model_validate(given).settings()


def after_restart(folder: Path, settings: ResilienceSettings) -> ResilienceSettings:
    with RunJournal(folder / "runs.db") as journal:
        return KeptSettings(settings, journal, structlog.get_logger()).current


def set_by_anna(folder: Path, settings: ResilienceSettings, **changed: Any) -> None:
    with RunJournal(folder / "runs.db") as journal:
        kept = KeptSettings(settings, journal, structlog.get_logger())
        kept.keep(replace(kept.current, **changed), "anna", 5.0)


def test_what_a_user_has_set_counts_after_a_restart(tmp_path: Path) -> None:
    set_by_anna(tmp_path, configured(), mode=DecisionMode.ABORT, limit_s=7.5, on_limit=OnLimit.ABORT)
    set_by_anna(tmp_path, configured(), judgements={("availability", "battery"): 3.0})
    settings = after_restart(tmp_path, configured())
    assert (settings.mode, settings.limit_s, settings.on_limit) == (DecisionMode.ABORT, 7.5, OnLimit.ABORT)
    assert settings.judgements == {("availability", "battery"): 3.0}
    with RunJournal(tmp_path / "runs.db") as journal:
        assert {name: (one.by, one.at) for name, one in journal.settings().items()} == {
            "mode": ("anna", 5.0),
            "judgements": ("anna", 5.0),
        }


@pytest.mark.parametrize(
    ("later", "mode", "judgement"),
    [
        ({"mode": "automatic"}, DecisionMode.AUTOMATIC, 3.0),
        ({"limit_s": 10}, DecisionMode.OPERATOR, 3.0),
        ({"judgements": {"battery": {"availability": 4}}}, DecisionMode.ABORT, 4.0),
        ({"criteria": CRITERIA | {"battery": CRITERIA["battery"] | {"range": [0, 50]}}}, DecisionMode.ABORT, 3.0),
        ({"synthesis": "ideal"}, DecisionMode.ABORT, 3.0),
    ],
)
def test_a_later_change_of_the_configuration_counts(
    tmp_path: Path, later: dict[str, Any], mode: DecisionMode, judgement: float
) -> None:
    set_by_anna(tmp_path, configured(), mode=DecisionMode.ABORT)
    set_by_anna(tmp_path, configured(), judgements={("battery", "availability"): 3.0})
    settings = after_restart(tmp_path, configured(**later))
    assert (settings.mode, settings.judgements["battery", "availability"]) == (mode, judgement)
    settings = after_restart(tmp_path, configured())  # what was overruled does not come back
    assert settings.mode is (DecisionMode.ABORT if mode is DecisionMode.ABORT else DecisionMode.OPERATOR)


def test_other_criteria_need_other_judgements(tmp_path: Path) -> None:
    set_by_anna(tmp_path, configured(), judgements={("battery", "availability"): 3.0})
    only = {"availability": CRITERIA["availability"]}
    assert after_restart(tmp_path, configured(criteria=only, judgements={})).judgements == {}


def test_setting_what_the_configuration_says_takes_a_change_back(tmp_path: Path) -> None:
    set_by_anna(tmp_path, configured(), mode=DecisionMode.ABORT)
    set_by_anna(tmp_path, configured(), mode=DecisionMode.OPERATOR)
    with RunJournal(tmp_path / "runs.db") as journal:
        assert journal.settings() == {}


def test_what_cannot_be_read_does_not_count(tmp_path: Path) -> None:
    set_by_anna(tmp_path, configured(), mode=DecisionMode.ABORT)
    with RunJournal(tmp_path / "runs.db") as journal:
        stored = journal.settings()["mode"]
        journal.keep_setting("mode", stored._replace(value='{"mode": "nobody", "limit_s": 1, "on_limit": "best"}'))
        journal.keep_setting("what a later version knows", StoredSetting("1", "2", "anna", 1.0))
    assert after_restart(tmp_path, configured()) == configured()


def test_what_cannot_be_kept_has_not_changed(tmp_path: Path) -> None:
    journal = RunJournal(tmp_path / "runs.db")
    kept = KeptSettings(configured(), journal, structlog.get_logger())
    journal.close()
    with pytest.raises(StorageUnavailable):
        kept.keep(replace(kept.current, mode=DecisionMode.ABORT), "anna", 1.0)
    assert kept.current == configured()


def test_a_journal_from_before_there_were_settings_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    RunJournal(path).close()
    connection = sqlite3.connect(path)
    connection.execute("DROP TABLE settings")
    connection.commit()
    connection.close()
    with RunJournal(path) as journal:
        assert journal.settings() == {}
