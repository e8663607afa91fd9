"""The operations that a page can ask for, by their names."""

from typing import Final

from ua_fleet.console.operations.alarms import ALARM_OPERATIONS
from ua_fleet.console.operations.kinds import OperationKind
from ua_fleet.console.operations.messages import MESSAGE_OPERATIONS
from ua_fleet.console.operations.nodes import NODE_OPERATIONS
from ua_fleet.console.operations.resilience import RESILIENCE_OPERATIONS
from ua_fleet.console.operations.robots import ROBOT_OPERATIONS
from ua_fleet.console.operations.scenarios import SCENARIO_OPERATIONS
from ua_fleet.console.operations.skills import SKILL_OPERATIONS

__all__ = ["OPERATIONS"]

_ALL: Final = (
    *SKILL_OPERATIONS,
    *ROBOT_OPERATIONS,
    *SCENARIO_OPERATIONS,
    *RESILIENCE_OPERATIONS,
    *ALARM_OPERATIONS,
    *NODE_OPERATIONS,
    *MESSAGE_OPERATIONS,
)
OPERATIONS: Final[dict[str, OperationKind]] = {kind.name: kind for kind in _ALL}
