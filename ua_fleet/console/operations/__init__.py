"""The operations that a page can ask for, by their names."""

from typing import Final

from ua_fleet.console.operations.kinds import OperationKind
from ua_fleet.console.operations.robots import ROBOT_OPERATIONS
from ua_fleet.console.operations.skills import SKILL_OPERATIONS

__all__ = ["OPERATIONS"]

OPERATIONS: Final[dict[str, OperationKind]] = {kind.name: kind for kind in (*ROBOT_OPERATIONS, *SKILL_OPERATIONS)}
