"""Feed `robot`: all of one robot.

Keys: `robot` (what it is), `state`, `held`; `data/NODEID` (what a Variable is) and `value/NODEID` (what it has);
`skill/NAME` (a skill and its arguments) and `now/NAME` (how it stands); `execution/ID` (one of its last executions).
"""

from __future__ import annotations

from contextlib import aclosing
from typing import Any, Final

from pydantic import Field

from ua_fleet.client import DataNode, FleetClient, Reading, RobotNodes, SkillNodes, ValueDetails, robot_nodes
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters
from ua_fleet.console.feeds.robots import held_shown, state_shown
from ua_fleet.console.shown import harmless_value, shown_reading, shown_value
from ua_fleet.skill import ExecutionState

__all__ = ["ROBOT"]

_STANDS: Final = ("CurrentState", "Progress", "ExecutionId", "Message", "LastStatus")
_IS: Final = ("Description", "Origin", "Capacities")
_STATES: Final = {int(state): state.name.lower() for state in ExecutionState}
_HELD: Final = ("HeldBy", "HeldSince", "HeldReason")


class RobotFeedParameters(FeedParameters):
    """Which robot."""

    robot: str = Field(min_length=1, max_length=200)


def details_shown(details: ValueDetails) -> dict[str, Any]:
    """Unit, range, and names of an enumeration."""
    shown: dict[str, Any] = {"unit": harmless_value(details.unit)}
    if details.low is not None and details.high is not None:
        shown |= {"low": shown_value(details.low), "high": shown_value(details.high)}
    if details.names:
        shown["names"] = {str(number): harmless_value(name) for number, name in details.names.items()}
    return shown


def _data_shown(one: DataNode) -> dict[str, Any]:
    return {
        "path": harmless_value(list(one.path)),
        "folder": one.folder,
        "type": one.type_name,
        "writable": one.writable,
        "history": one.has_history,
        "description": harmless_value(one.description),
        **details_shown(one.details),
    }


def _skill_shown(one: SkillNodes) -> dict[str, Any]:
    return {
        "name": one.name,
        "node": one.node_id,
        "description": harmless_value(one.description),
        "timeout_s": one.timeout_s,
        "arguments": [
            {
                "name": argument.name,
                "type": argument.type_name,
                "help": harmless_value(argument.description),
                "default": shown_value(argument.default),
                **details_shown(argument.details),
            }
            for argument in one.arguments
        ],
    }


class _Shown:
    """Puts what is heard of one robot's nodes onto the board."""

    def __init__(self, robot: RobotNodes, board: Board) -> None:
        self._robot, self._board = robot, board
        node = robot.node_id
        self._parts: dict[str, Reading] = {}
        self._own = {f"{node}.{part}": part for part in ("State", *_IS, *_HELD)}
        self._skills = {
            skill.members[part]: (skill.name, part)
            for skill in robot.skills
            for part in _STANDS
            if part in skill.members
        }
        self._stands: dict[str, dict[str, Reading]] = {skill.name: {} for skill in robot.skills}
        self._arrays = {node: name for name, node in robot.executions.items()}
        self._columns: dict[str, Reading] = {}
        self._executions: set[str] = set()
        self._missing = {*self._own, *self._skills, *self._arrays, *(one.node_id for one in robot.data)}
        self.watched = list(self._missing)

    def describe(self) -> None:
        """Say what there is."""
        board, keys = self._board, {"robot", "state", "held"}
        for one in self._robot.data:
            board.put(f"data/{one.node_id}", _data_shown(one))
            keys |= {f"data/{one.node_id}", f"value/{one.node_id}"}
        for skill in self._robot.skills:
            board.put(f"skill/{skill.name}", _skill_shown(skill))
            keys |= {f"skill/{skill.name}", f"now/{skill.name}"}
        board.keep(keys | self._executions)

    def take(self, reading: Reading) -> None:
        """Show a value."""
        node = reading.node_id
        if node in self._own:
            self._take_own(self._own[node], reading)
        elif node in self._skills:
            name, part = self._skills[node]
            self._stands[name][part] = reading
            self._board.put(f"now/{name}", _now(self._stands[name]))
        elif node in self._arrays:
            self._columns[self._arrays[node]] = reading
            if len(self._columns) == len(self._arrays):
                self._take_executions()
        else:
            self._board.put(f"value/{node}", shown_reading(reading))
        if self._missing:
            self._missing.discard(node)
            if not self._missing:
                self._board.ready()

    def _take_executions(self) -> None:
        """The last executions; the newest is the last of them."""
        columns: dict[str, list[Any]] = {name: reading.exact or [] for name, reading in self._columns.items()}
        shown: set[str] = set()
        for place, execution in enumerate(columns.get("ExecutionId", [])):

            def part(name: str, place: int = place) -> Any:
                column = columns.get(name, [])
                return column[place] if place < len(column) else None

            state = part("State")
            key = f"execution/{execution.hex()}"
            shown.add(key)
            self._board.put(
                key,
                {
                    "execution": execution.hex(),
                    "place": place,
                    "skill": harmless_value(part("Skill") or ""),
                    "state": _STATES.get(state, str(state)),
                    "progress": shown_value(part("Progress")),
                    "message": harmless_value(part("Message") or ""),
                    "result": harmless_value(part("Result") or ""),
                    "status": shown_value(part("Status")),
                },
            )
        for key in self._executions - shown:
            self._board.gone(key)
        self._executions = shown

    def _take_own(self, part: str, reading: Reading) -> None:
        self._parts[part] = reading
        values = {name: one.value for name, one in self._parts.items()}
        if part == "State":
            self._board.put("state", state_shown(reading))
        elif part in _HELD:
            held = held_shown(values.get("HeldBy"), self._parts.get("HeldSince"), values.get("HeldReason"))
            self._board.put("held", held)
        else:
            shown = {
                "name": self._robot.name,
                "node": self._robot.node_id,
                "description": harmless_value(str(values.get("Description") or "")),
                "origin": str(values.get("Origin") or ""),
                "capacities": harmless_value(list(values.get("Capacities") or ())),
            }
            self._board.put("robot", shown)


def _now(stands: dict[str, Reading]) -> dict[str, Any]:
    def value(part: str) -> Any:
        reading = stands.get(part)
        return shown_value(reading.exact) if reading is not None else None

    state = stands.get("CurrentState")
    return {
        "state": value("CurrentState"),
        "s": state.status if state is not None else 0,
        "execution": value("ExecutionId") or "",
        "progress": value("Progress"),
        "message": harmless_value(value("Message") or ""),
        "status": value("LastStatus"),
    }


async def _run(client: FleetClient, parameters: RobotFeedParameters, board: Board) -> None:
    async def look() -> RobotNodes:
        return await robot_nodes(client, parameters.robot)

    async def show(robot: RobotNodes) -> None:
        shown = _Shown(robot, board)
        shown.describe()
        # A page is told the newest alone: pictures of a camera that come between two publications stay in the server.
        watched = client.watch(shown.watched, period_ms=100, with_times=True, newest_only=True)
        async with aclosing(watched) as changes:
            async for reading in changes:
                shown.take(reading)

    await followed(client, look, show)


ROBOT: Final = FeedKind("robot", RobotFeedParameters, _run)
