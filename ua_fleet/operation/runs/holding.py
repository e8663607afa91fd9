"""Robots that people hold back from tasks, as the service has them: checked, written down, and carried out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final, Protocol

from ua_fleet.errors import ScenarioError
from ua_fleet.orchestrator import Hold, HoldChanged, Orchestrator, Output

__all__ = ["RobotHolds"]

MOST_REASON: Final = 200
"""Characters of why a robot is held."""


class Do(Protocol):
    """Writes down what has happened, and carries it out."""

    def __call__(self, outputs: list[Output], *, must_be_written: bool = False) -> None:
        """Raises StorageUnavailable where it cannot be written, and somebody must know."""
        ...


class RobotHolds:
    """Who holds which robot."""

    def __init__(
        self, orchestrator: Orchestrator, do: Do, check_robot: Callable[[str], object], wall_s: Callable[[], float]
    ) -> None:
        """Connect the parts.

        Args:
            orchestrator: gives robots to tasks.
            do: carries out what follows.
            check_robot: raises ScenarioUnknown where there is no such robot.
            wall_s: seconds since 1970.
        """
        self._orchestrator, self._do, self._check, self._wall_s = orchestrator, do, check_robot, wall_s

    def __iter__(self) -> Iterator[Hold]:
        return iter(self._orchestrator.holds)

    def restore(self, holds: Iterable[Hold]) -> None:
        """Robots that were held before a restart are held, also those that may come again; before runs go on."""
        self._orchestrator.holds.restore(holds)

    def hold(self, robot: str, reason: str, by: str) -> None:
        """Have runs give a robot no further task.

        Raises:
            ScenarioUnknown: there is no such robot.
            ScenarioError: somebody else holds it.
            StorageUnavailable: it cannot be written down yet; it counts all the same.
        """
        self._check(robot)
        reason = " ".join(reason.split())[:MOST_REASON]
        self._do(self._orchestrator.hold(robot, by, reason, self._wall_s()), must_be_written=True)

    def release(self, robot: str, by: str) -> None:
        """Let runs give a robot tasks again, whoever holds it.

        Raises:
            ScenarioUnknown: there is no such robot.
            ScenarioError: nobody holds it.
            StorageUnavailable: as of `hold`.
        """
        self._check(robot)
        if self._orchestrator.holds.get(robot) is None:
            raise ScenarioError(f"{robot} is not held")
        self._do(self._orchestrator.release(robot, by, self._wall_s()), must_be_written=True)

    def show_again(self, robot: str) -> None:
        """A robot has come: whether it is held is shown at its new nodes."""
        hold = self._orchestrator.holds.get(robot)
        if hold is not None:
            self._do([HoldChanged(hold, True, hold.by)])
