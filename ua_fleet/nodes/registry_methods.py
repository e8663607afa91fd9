"""RegisterRobot and UnregisterRobot of the fleet's Object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from ua_fleet.config.registration import RobotText
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import ConfigInvalid, UaFleetError
from ua_fleet.nodes.method_factory import NOT_FOUND, NOT_POSSIBLE, MethodArgument, MethodFactory, NotValid, caller
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.operation.robots.roster import RobotRegistry, RobotUnknown
from ua_fleet.values import ARRAY, BuiltinType, NodeId

__all__ = ["RobotRegistryMethods"]

_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_COUNTS: Final = int(BuiltinType.INT32 | ARRAY)
_NOWHERE: Final = NodeId(0, 0)


class RobotRegistryMethods:
    """Answers the Methods."""

    def __init__(self, server: HardenedServer, parts: NodeFactory, roster: RobotRegistry) -> None:
        """Prepare to answer for the robots of a roster; `build` makes the Methods."""
        self._roster = roster
        self._methods = MethodFactory(server, parts, _code_of)

    def build(self) -> None:
        """Make the Methods and let them be called."""
        name = MethodArgument("Name", _TEXT, "name of the robot")
        self._methods.add("Fleet", "RegisterRobot", Role.ENGINEER, self._register, (
            name,
            MethodArgument("Bridge", _TEXT, "name of its bridge, or number of its space; empty: clients do its skills"),
            MethodArgument("Capacities", _TEXTS, "what it can do in kind; empty: as the definition says"),
            MethodArgument("Description", _TEXT, "for people; empty: as the definition says"),
            MethodArgument("Definition", _TEXT, "skills and data as in fleet.yaml below robots.<robot>, YAML or JSON"),
        ), (
            MethodArgument("Robot", int(BuiltinType.NODE_ID), "the robot's Object"),
            MethodArgument("Problems", _TEXTS, "all that is wrong with the definition"),
            MethodArgument("Lines", _COUNTS, "the line of each problem; 0 where it has none"),
        ), "Make a robot one of the fleet. Said again, it changes nothing.")  # fmt: skip
        self._methods.add(
            "Fleet", "UnregisterRobot", Role.ENGINEER, self._unregister, (name,), (), "Take a robot out of the fleet."
        )

    async def _register(
        self, name: str, bridge: str, capacities: list[str], description: str, definition: str
    ) -> Sequence[Any]:
        said = RobotText(name, bridge.strip(), tuple(capacities), description, definition)
        try:
            robot = self._roster.register(said, caller().name)
        except ConfigInvalid as error:
            problems, lines = [str(one) for one in error.problems], [one.line for one in error.problems]
            raise NotValid(problems[0], (_NOWHERE, problems, lines)) from error
        return robot.key, [], []

    async def _unregister(self, name: str) -> Sequence[Any]:
        self._roster.unregister(name, caller().name)
        return ()


def _code_of(error: UaFleetError) -> int:
    return NOT_FOUND if isinstance(error, RobotUnknown) else NOT_POSSIBLE
