"""What the user of a connection may do, as the server itself says it (UserExecutable, OPC 10000-3 5.7).

A page hides by it what would be refused. It is never what decides: the server does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from ua_fleet.client import FleetClient
from ua_fleet.console.operations import OPERATIONS

__all__ = ["ROLES", "Rights", "rights_of"]

ROLES: Final = ("observer", "operator", "engineer")
_ASKED: Final = {"operator": "ns=2;s=Fleet.Scenarios.Run", "engineer": "ns=2;s=Fleet.RegisterRobot"}
"""For each role a Method that this one may call and none below it."""
_DRIVING: Final = {"teleoperation.drive": "operator", "teleoperation.take_over": "engineer"}
"""What is no operation, since it goes over a WebSocket of its own, and the least role that may."""


@dataclass(frozen=True, slots=True)
class Rights:
    """The roles that a user has."""

    roles: tuple[str, ...] = ()

    @property
    def shown(self) -> dict[str, Any]:
        """For the page: the roles, and the operations that they may do."""
        least = {**{name: one.role for name, one in OPERATIONS.items()}, **_DRIVING}
        return {"roles": list(self.roles), "may": [name for name, role in least.items() if role in self.roles]}


async def rights_of(client: FleetClient) -> Rights:
    """The rights of a client's user; raises what a read does."""
    allowed = await client.executable(list(_ASKED.values()))
    return Rights(("observer", *(role for role, may in zip(_ASKED, allowed, strict=True) if may)))
