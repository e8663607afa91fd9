"""Who takes tasks over, as people decide it: previewed, judged, confirmed, forecast, and how it is decided at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ua_fleet.operation.runs.decision_judgements import DecisionJudgements
from ua_fleet.operation.runs.holding import Do
from ua_fleet.operation.runs.kept_settings import KeptSettings
from ua_fleet.operation.runs.library import MOST_NAME, ScenarioUnknown
from ua_fleet.orchestrator import FaultForecast, Orchestrator, ResilienceSettings
from ua_fleet.resilience import Confirmation, Judgements, Ranking

__all__ = ["OperatorDecisions"]


class OperatorDecisions:
    """Open decisions, and the settings of all of them. Methods raise UaFleetError with the reason."""

    def __init__(
        self,
        orchestrator: Orchestrator,
        judgements: DecisionJudgements,
        settings: KeptSettings,
        do: Do,
        check_robot: Callable[[str], object],
        take_news: Callable[[], None],
        wall_s: Callable[[], float],
    ) -> None:
        """Connect the parts.

        Args:
            orchestrator: has the decisions.
            judgements: of single decisions, over restarts.
            settings: of all decisions, over restarts.
            do: carries out what follows.
            check_robot: raises ScenarioUnknown where there is no such robot.
            take_news: takes in what became known of robots; called before anything is decided.
            wall_s: seconds since 1970.
        """
        self._orchestrator, self._judgements, self._settings = orchestrator, judgements, settings
        self._do, self._check_robot, self._take_news, self._wall_s = do, check_robot, take_news, wall_s

    def confirm(self, decision_id: str, robot: str, by: str) -> Confirmation:
        """Choose a replacement. Of two who choose at once the first decides, the other is told so."""
        self._take_news()
        self._check_decision(decision_id)
        confirmation, outputs = self._orchestrator.confirm(decision_id, robot, by, self._wall_s())
        self._do(outputs, must_be_written=True)
        return confirmation

    def preview(self, decision_id: str, judgements: Judgements | None) -> Ranking:
        """The ranking of an open decision with other judgements, which changes nothing; None: those that count.

        Raises:
            JudgementsInvalid: no weights can be made of them.
            ScenarioUnknown: there is no such decision.
        """
        self._check_decision(decision_id)
        return self._orchestrator.preview(decision_id, judgements)

    def judge(self, decision_id: str, judgements: Judgements | None, by: str) -> Ranking:
        """Rank an open decision with other judgements, also after a restart; None: with those of all.

        Raises:
            JudgementsInvalid: no weights can be made of them.
            ScenarioUnknown: there is no such decision.
            StorageUnavailable: it cannot be kept, and nothing has changed.
        """
        self._take_news()
        ranking = self.preview(decision_id, judgements)  # refuses what cannot be weighed before it is kept
        now = self._wall_s()
        if judgements is None:
            self._judgements.forget(decision_id)
        else:
            self._judgements.keep(decision_id, judgements, by, now)
        self._do(self._orchestrator.judge(decision_id, judgements, now))
        return ranking

    def _check_decision(self, decision_id: str) -> None:
        if decision_id not in self._orchestrator.decisions:
            raise ScenarioUnknown(
                f"there is no open decision {decision_id[:MOST_NAME]!r}; it may have been decided already"
            )

    def what_if(self, robot: str) -> tuple[int, Iterator[FaultForecast]]:
        """How many tasks a robot has ahead, and who would take over each of them, one by one and without effect."""
        self._check_robot(robot)
        return self._orchestrator.what_if(robot)

    def set_settings(self, settings: ResilienceSettings, by: str) -> None:
        """Other judgements or modes, also after a restart; open decisions are ranked again.

        Raises:
            StorageUnavailable: it cannot be kept, and nothing has changed.
        """
        self._take_news()
        self._settings.keep(settings, by, self._wall_s())
        self._do(self._orchestrator.set_settings(settings, self._wall_s()))
