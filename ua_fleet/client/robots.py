# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""The robots of a fleet: which there are, and those that come and go while the server runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from asyncua import ua

from ua_fleet.client.methods import NotDone, Returned, call_method, text, texts
from ua_fleet.client.scenarios import Problem

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["RobotClient", "RobotInfo", "RobotInvalid"]

_HOLD: Final = "ns=3;i=72051"
_RELEASE: Final = "ns=3;i=72052"
"""Methods of RobotType, which all robots share."""

_STATES: Final = ("offline", "idle", "busy", "faulted")
"""RobotStateEnumeration of the UaFleet nodeset."""


class RobotInvalid(NotDone):
    """The definition of a robot has mistakes."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__(2, "\n".join(problem.text for problem in self.problems))


@dataclass(frozen=True, slots=True)
class RobotInfo:
    """A robot as it is now."""

    name: str
    state: str
    """`offline`, `idle`, `busy` or `faulted`."""
    origin: str
    """How it came to the fleet: `fleet.yaml`, `registered` or `announced`."""
    capacities: tuple[str, ...]
    skills: tuple[str, ...]
    description: str
    held_by: str = ""
    """Who holds it back from tasks; empty: nobody."""
    held_since: str | None = None
    """ISO 8601."""
    held_reason: str = ""


class RobotClient:
    """What engineers do with robots. Methods raise NotDone with the server's reason."""

    def __init__(self, client: FleetClient) -> None:
        self._client = client

    async def robots(self) -> list[RobotInfo]:
        """All robots, by their names."""
        nodes = await self._client.robots()
        names = ("State", "Origin", "Capacities", "Description", "HeldBy", "HeldSince", "HeldReason")
        asked = [f"{node.to_string()}.{name}" for node in nodes.values() for name in names]
        told = iter(await self._client.read(asked))
        skills: dict[str, list[str]] = {name: [] for name in nodes}
        for skill in await self._client.skill_nodes():
            if skill.robot in skills:
                skills[skill.robot].append(skill.name)
        found: list[RobotInfo] = []
        for name in nodes:
            state, origin, capacities, description, *held = [next(told).value for _ in names]
            found.append(
                RobotInfo(
                    name,
                    _STATES[state] if state in range(len(_STATES)) else str(state),
                    str(origin),
                    tuple(capacities or ()),
                    tuple(skills[name]),
                    str(description or ""),
                    str(held[0] or ""),
                    held[1] if held[0] else None,
                    str(held[2] or ""),
                )
            )
        return sorted(found, key=lambda robot: robot.name)

    async def register(
        self,
        name: str,
        definition: str | Mapping[str, Any] = "",
        *,
        bridge: str = "",
        capacities: Sequence[str] = (),
        description: str = "",
    ) -> str:
        """Make a robot one of the fleet, and return its NodeId. Said again, it changes nothing.

        Args:
            name: of the robot.
            definition: skills and data as below `robots.<robot>` in `fleet.yaml`, or a file that has this robot.
            bridge: name of its bridge, or the number of its space; without it clients do its skills.
            capacities: in place of those of the definition.
            description: in place of that of the definition.

        Raises:
            RobotInvalid: all mistakes, with their lines in the definition.
            NotDone: there is another robot of that name.
        """
        said = definition if isinstance(definition, str) else json.dumps(definition)
        done = await call_method(
            self._client,
            "Fleet",
            "RegisterRobot",
            text(name),
            text(bridge),
            texts(list(capacities)),
            text(description),
            text(said),
        )
        node, problems, lines = done.outputs
        if problems:
            raise RobotInvalid([Problem(line, problem) for line, problem in zip(lines, problems, strict=True)])
        done.check()
        assert isinstance(node, ua.NodeId)
        return node.to_string()

    async def unregister(self, name: str) -> None:
        """Take a robot out of the fleet; NotDone where it is in use, or in the server's `fleet.yaml`."""
        (await call_method(self._client, "Fleet", "UnregisterRobot", text(name))).check()

    async def hold(self, name: str, reason: str = "") -> None:
        """Have runs give a robot no further task; what it is at goes on. NotDone where somebody else holds it."""
        await self._call(name, _HOLD, text(reason))

    async def release(self, name: str) -> None:
        """Let runs give a robot tasks again, whoever holds it; NotDone where nobody does."""
        await self._call(name, _RELEASE)

    async def _call(self, name: str, method: str, *arguments: ua.Variant) -> None:
        *_, status, message = await self._client.call(f"ns=2;s=Robots.{name}", method, *arguments)
        Returned([], int(status), str(message)).check()
