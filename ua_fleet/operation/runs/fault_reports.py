"""Faults that people and robots report by Methods: raised, cleared and acknowledged."""

from __future__ import annotations

from collections.abc import Callable

from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.model import RobotModel
from ua_fleet.operation.runs.holding import Do
from ua_fleet.operation.runs.library import MOST_NAME, ScenarioUnknown
from ua_fleet.operation.runs.robot_news import RobotNews
from ua_fleet.orchestrator import Orchestrator, Output
from ua_fleet.scenario.consequences import BRIDGE_OFF, RAISED, SKILL

__all__ = ["FaultReports"]


class FaultReports:
    """What people and robots may report of faults. Methods raise UaFleetError with the reason."""

    def __init__(
        self,
        orchestrator: Orchestrator,
        news: RobotNews,
        do: Do,
        robot: Callable[[str], RobotModel],
        wall_s: Callable[[], float],
    ) -> None:
        """Connect the parts.

        Args:
            orchestrator: has the faults.
            news: what is known of robots; it is taken in before anything is decided.
            do: carries out what follows.
            robot: a robot by its name; raises ScenarioUnknown where there is none.
            wall_s: seconds since 1970.
        """
        self._orchestrator, self._news, self._do = orchestrator, news, do
        self._robot, self._wall_s = robot, wall_s

    def raise_fault(self, robot: str, reason: str) -> None:
        """A robot, or somebody for it, says that it cannot work; `mobile: the drive is hot`: that it is not mobile."""
        self._news.take_news()
        reason = " ".join(reason.split())[:MOST_NAME] or "it says that it cannot work"
        capacities, rest = self._news.fleet.named_first(self._robot(robot).name, reason)
        outputs = self._orchestrator.fault_raised(robot, "robot", rest or reason, self._wall_s(), capacities)
        self._do(outputs, must_be_written=True)

    def bridge_is_off(self, robot: str, reason: str) -> None:
        """A person has said that nobody can reach it: a fault of its own, so that its end ends no other one."""
        self._do(self._orchestrator.fault_raised(robot, BRIDGE_OFF, reason, self._wall_s()), must_be_written=True)

    def bridge_is_back(self, robot: str) -> None:
        """It is heard again; where that cannot be written down now, it is later."""
        for source in (BRIDGE_OFF, RAISED):  # RAISED: versions before had this as one, and bridges have no other of it
            self._do(self._orchestrator.fault_cleared(robot, source, self._wall_s()))

    def forget_failures(self) -> None:
        """Robots may be asked again for what they have failed at; written down later where it cannot be now."""
        for fault in [one for one in self._orchestrator.faults if one.active and one.source == SKILL]:
            self._do(self._orchestrator.fault_cleared(fault.robot, SKILL, self._wall_s()))

    def are_off(self) -> set[str]:
        """Robots whose bridges a person has said to be off, and that were not heard since."""
        faults = self._orchestrator.faults
        return {fault.robot for fault in faults if fault.active and fault.source in (BRIDGE_OFF, RAISED)}

    def can_do_nothing(self, robot: str) -> bool:
        """Whether its faults take all capacities of a robot away; one that names none takes all."""
        view = self._news.fleet.robots.get(robot)
        each = [(capacity,) for capacity in view.capacities] if view is not None else []
        faults = self._orchestrator.faults
        return bool(faults.keeping(robot, ())) or (bool(each) and all(faults.keeping(robot, one) for one in each))

    def clear_fault(self, name: str) -> None:
        """A robot, or somebody for it, says that it can work again.

        Args:
            name: of the robot, for all of its faults; or the id of one of them, `<robot>.<source>`.

        Raises:
            ScenarioUnknown: there is no such robot, and no fault of one that has left; or it has no such fault.
            ScenarioError: it has no other faults than those whose cause is there still.
        """
        self._news.take_news()
        robot, _, source = name.partition(".")
        active = self._orchestrator.faults.active(robot)
        if not active:
            self._robot(robot)  # of one that has left the fleet, what stays can be cleared
        if source:
            known = ", ".join(fault.id for fault in active) or "none"
            active = [fault for fault in active if fault.source == source]
            if not active:
                raise ScenarioUnknown(f"{robot} has no fault {name[:MOST_NAME]!r}; its faults now: {known}")
        there = [fault for fault in active if self._news.finder.is_there(fault)]
        if active and active == there:
            causes = ", ".join(f"{fault.source} ({fault.reason})" for fault in there)
            raise ScenarioError(f"{robot} has a fault whose cause is still there: {causes}; it ends by itself")
        outputs: list[Output] = []
        for fault in active:
            if fault not in there:
                outputs += self._orchestrator.fault_cleared(robot, fault.source, self._wall_s())
        self._do(outputs, must_be_written=True)

    def acknowledge(self, fault_id: str, by: str) -> None:
        """Somebody has seen a fault."""
        self._news.take_news()
        self._do(self._orchestrator.acknowledge(fault_id, by, self._wall_s()), must_be_written=True)
