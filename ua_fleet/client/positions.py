# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Which Variables of robots say where they are, by their names, and the places that the fleet knows.

A robot says where it is by `x` and `y` of data whose name is one of POSITIONS, or which have such a name above them, as
`pose.x` or `odom.pose.pose.position.x`; where it looks, by `heading`, `yaw` or `theta` beside them, or by an
`orientation`. So what `nav_msgs/Odometry` and `geometry_msgs/PoseStamped` have is found as it is; `fleet.yaml` marks
other data by naming it so.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from asyncua import ua

from ua_fleet.client.browsing import variables_below
from ua_fleet.client.details import value_details
from ua_fleet.client.translated import translated
from ua_fleet.fleet.quantities import UnitsDiffer, convert

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["POSITIONS", "PositionNodes", "find_position", "known_places", "position_nodes", "yaw_of"]

POSITIONS: Final = ("position", "pose", "odometry", "odom", "location")
"""The first that a robot has is taken."""
_OTHERS: Final = frozenset({"twist", "velocity", "goal", "target", "setpoint", "orientation", "covariance"})
"""What has `x` and `y` too, and is no position; or not the robot's own."""
_HEADINGS: Final = ("heading", "yaw", "theta")
_FRAMES: Final = ("frame", "frame_id")
_PLACES: Final = "ns=2;s=Fleet.Places"


@dataclass(frozen=True, slots=True)
class PositionNodes:
    """The Variables of one robot; NodeIds."""

    robot: str
    x: str
    y: str
    metres: float
    """What a 1 of `x` and `y` is."""
    heading: str = ""
    """Counterclockwise from the x axis; empty: there is none."""
    radians: float = 1.0
    """What a 1 of `heading` is."""
    orientation: tuple[str, ...] = ()
    """In place of a heading: x, y, z and w of a quaternion, or z and w."""
    frame: str = ""
    """Names the coordinate system; empty: none is told."""

    @property
    def nodes(self) -> tuple[str, ...]:
        """All of them."""
        return (self.x, self.y, *self.orientation, *(one for one in (self.heading, self.frame) if one))


_Parts = tuple[str, ...]


def find_position(paths: Collection[_Parts]) -> tuple[_Parts, _Parts, _Parts | None, tuple[_Parts, ...], _Parts | None]:
    """The paths of x, y, heading, orientation and frame among those of a robot's data; empty ones where it has none.

    A path has the browse names from the folder down; a dot in a name is a step too.
    """
    known = {_steps(path): path for path in paths}
    best: tuple[int, int, _Parts] | None = None
    for steps in known:
        if steps[-1] != "x" or len(steps) < 2 or (*steps[:-1], "y") not in known or _OTHERS.intersection(steps):
            continue
        ranks = [POSITIONS.index(step) for step in steps if step in POSITIONS]
        # Of data of one name the shorter path: `pose.x` before `pose.pose.position.x`.
        rank = (POSITIONS.index(steps[0]) if steps[0] in POSITIONS else len(POSITIONS), len(steps), steps)
        if ranks and (best is None or rank < best):
            best = rank
    if best is None:
        return (), (), None, (), None
    above = best[2][:-1]
    base = above[:-1] if above[-1] == "position" and len(above) > 1 else above
    heading = next((known[(*up, name)] for up in (above, base) for name in _HEADINGS if (*up, name) in known), None)
    axes = [(*up, "orientation", axis) for up in (above, base) for axis in ("x", "y", "z", "w")]
    told = list(dict.fromkeys(known[axis] for axis in axes if axis in known))
    orientation = tuple(told) if {"z", "w"} <= {_steps(one)[-1] for one in told} and len(told) in (2, 4) else ()
    frames = (
        (*above[:size], *more, name)
        for size in range(len(above), 0, -1)
        for more in ((), ("header",))
        for name in _FRAMES
    )
    frame = next((known[one] for one in frames if one in known), None)
    return known[(*above, "x")], known[(*above, "y")], heading, orientation, frame


def _steps(path: _Parts) -> _Parts:
    return tuple(".".join(path).lower().split("."))


def yaw_of(orientation: Iterable[float]) -> float | None:
    """The rotation about the vertical axis that a quaternion (x, y, z and w, or z and w) tells; None of none."""
    *tilt, z, w = orientation
    x, y = tilt or (0.0, 0.0)
    length = x * x + y * y + z * z + w * w
    if not math.isfinite(length) or length < 0.5:
        return None
    return math.atan2(2 * (w * z + x * y), length - 2 * (y * y + z * z))


async def position_nodes(client: FleetClient, most: int) -> list[PositionNodes]:
    """Those of all robots that have some; none of a fleet of more than `most` robots. Raises NotConnected."""
    robots = await client.robots()
    if len(robots) > most:
        return []
    with translated(client.endpoint):
        data = await _data(client, {name: node.to_string() for name, node in robots.items()})
        found = {robot: find_position(paths) for robot, paths in data.items()}
        wanted = [
            ua.NodeId.from_string(data[robot][path])
            for robot, (x, _, heading, _, _) in found.items()
            for path in (x, heading)
            if path
        ]
        units = {
            node.to_string(): detail.unit
            for node, detail in zip(wanted, await value_details(client.batches, wanted), strict=True)
        }
    positions: list[PositionNodes] = []
    for robot, (x, y, heading, orientation, frame) in sorted(found.items()):
        nodes = data[robot]
        metres = _factor(units.get(nodes[x], ""), "m") if x else None
        radians = _factor(units.get(nodes[heading], ""), "rad") if heading else None
        if metres is None:
            continue
        positions.append(
            PositionNodes(
                robot,
                nodes[x],
                nodes[y],
                metres,
                nodes[heading] if heading and radians is not None else "",
                radians or 1.0,
                () if heading else tuple(nodes[one] for one in orientation),
                nodes[frame] if frame else "",
            )
        )
    return positions


def _factor(unit: str, wanted: str) -> float | None:
    """What a 1 of a unit is; without one it is the usual one of ROS. None: it measures something else."""
    try:
        return convert(1.0, unit or wanted, wanted)
    except UnitsDiffer:
        return None


async def _data(client: FleetClient, robots: Mapping[str, str]) -> dict[str, dict[_Parts, str]]:
    """NodeIds of the Variables of robots' data by their paths."""
    found: dict[str, dict[_Parts, str]] = {name: {} for name in robots}
    data = {name: ua.NodeId.from_string(f"{node}.Data") for name, node in robots.items()}
    for one in await variables_below(client.batches, data):
        found[one.root][one.path] = one.node.to_string()
    return found


async def known_places(client: FleetClient) -> dict[str, tuple[float, float]]:
    """The places that the fleet knows by name, in metres; none where the server tells none. Raises NotConnected."""
    with translated(client.endpoint):
        (children,) = await client.batches.browse([ua.NodeId.from_string(_PLACES)])
        variables = [child for child in children if child.NodeClass is ua.NodeClass.Variable]
        told = await client.batches.read([child.NodeId for child in variables])
    places: dict[str, tuple[float, float]] = {}
    for child, data in zip(variables, told, strict=True):
        value = data.Value.Value if data.Value is not None else None
        if isinstance(value, list) and len(value) == 2:
            places[str(child.BrowseName.Name)] = float(value[0]), float(value[1])
    return places
