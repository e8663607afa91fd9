"""Hold and Release of a robot's Object: the Methods of RobotType, which all robots share."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import UaFleetError
from ua_fleet.nodes.hold_nodes import HOLD, RELEASE
from ua_fleet.nodes.method_factory import NOT_FOUND, NOT_POSSIBLE, MethodFactory, caller
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.operation.runs.holding import RobotHolds
from ua_fleet.operation.runs.library import ScenarioUnknown

__all__ = ["RobotMethods"]

_ROBOTS: Final = "Robots."


class RobotMethods:
    """Answers the Methods."""

    def __init__(self, server: HardenedServer, parts: NodeFactory, holds: RobotHolds) -> None:
        """Let them be called by operators; the types are loaded.

        Args:
            server: whose Methods they are.
            parts: of the fleet.
            holds: does what is asked for.
        """
        self._ns, self._holds = parts.ns, holds
        methods = MethodFactory(server, parts, _code_of)
        methods.share(HOLD, "Hold", Role.OPERATOR, self._hold)
        methods.share(RELEASE, "Release", Role.OPERATOR, self._release)

    async def _hold(self, parent: ua.NodeId, reason: str) -> Sequence[Any]:
        self._holds.hold(self._robot(parent), reason, caller().name)
        return ()

    async def _release(self, parent: ua.NodeId) -> Sequence[Any]:
        self._holds.release(self._robot(parent), caller().name)
        return ()

    def _robot(self, parent: ua.NodeId) -> str:
        identifier: Any = parent.Identifier
        if int(parent.NamespaceIndex) != self._ns or not str(identifier).startswith(_ROBOTS):
            # The type has the Methods too, but nothing behind them.
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no robot")
        return str(identifier).removeprefix(_ROBOTS)


def _code_of(error: UaFleetError) -> int:
    return NOT_FOUND if isinstance(error, ScenarioUnknown) else NOT_POSSIBLE
