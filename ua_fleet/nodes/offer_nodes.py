"""What clients see of skills that they do: `Fleet/Offers`, its Methods, and an event for each change of a request."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import ConfigInvalid, UaFleetError
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.method_factory import NOT_FOUND, NOT_POSSIBLE, MethodArgument, MethodFactory, NotValid, caller
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.nodes.projection import Projection
from ua_fleet.operation.robots.offered_results import read_results
from ua_fleet.operation.robots.offers import ClientOffers, OfferedExecution
from ua_fleet.operation.robots.roster import RobotRegistry, RobotUnknown
from ua_fleet.skill.executions import EXECUTION_ID_BYTES
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId, Variant

__all__ = ["OFFERS", "OfferNodes"]

OFFERS: Final = "Fleet.Offers"
MOST_TEXT: Final = 1000
"""Characters of a message that a client gives."""
_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_COUNTS: Final = int(BuiltinType.INT32 | ARRAY)
_TIME: Final = int(BuiltinType.DATETIME)
_EVENT: Final = raw_id(TypeId.SKILL_REQUEST_EVENT.value, TYPES_INDEX)
_LISTS: Final = (
    *[(name, _TEXTS) for name in ("ExecutionIds", "Robots", "Skills", "Arguments", "TakenBy")],
    ("Until", int(BuiltinType.DATETIME | ARRAY)),
)
_SEVERITY: Final = {"asked": 400, "halt": 500, "unknown": 700, "failed": 600}
"""Where somebody has to look; all else is 100."""


class OfferNodes:
    """Shows what clients are asked for, and answers their Methods."""

    def __init__(
        self,
        server: HardenedServer,
        parts: NodeFactory,
        projection: Projection,
        roster: RobotRegistry,
        offers: ClientOffers,
        wall_ticks: Callable[[], int],
    ) -> None:
        """Prepare; `build` makes the nodes.

        Args:
            server: calls the Methods.
            parts: of the fleet; its values are those that the projection writes to.
            projection: shows changes in order with all others.
            roster: of the robots.
            offers: what clients do.
            wall_ticks: the wall clock.
        """
        self._parts, self._projection, self._roster, self._offers = parts, projection, roster, offers
        self._wall_ticks = wall_ticks
        self._events = ServerEvents(server.iserver)
        self._methods = MethodFactory(server, parts, _code_of)

    def build(self) -> None:
        """Make the nodes, and let the Methods be called."""
        parts = self._parts
        node = parts.object(OFFERS, "Offers", parts.id("Fleet"), TypeId.OFFERS)
        for name, kind in _LISTS:
            data_type = STANDARD["UtcTime"] if kind & 0x3F == _TIME else raw_id(kind & 0x3F)
            parts.variable(self._key(name), name, node, data_type, parts.waiting, is_array=True)
        self._show_lists()
        robot, skill = (
            MethodArgument("Robot", _TEXT, "name of the robot"),
            MethodArgument("Skill", _TEXT, "name of the skill"),
        )
        execution = MethodArgument("ExecutionId", _TEXT, "the execution, 32 hexadecimal digits")
        message = MethodArgument("Message", _TEXT, "one line for people")
        for name, work, inputs, outputs, text in (
            (
                "OfferSkill",
                self._offer,
                (
                    robot,
                    skill,
                    MethodArgument("Definition", _TEXT, "the skill as in fleet.yaml; empty: as it is known"),
                ),
                (
                    MethodArgument("SkillNode", int(BuiltinType.NODE_ID), "the skill's Object"),
                    MethodArgument("Problems", _TEXTS, "all that is wrong with the definition"),
                    MethodArgument("Lines", _COUNTS, "the line of each problem; 0 where it has none"),
                ),
                "This client does a skill from now on, as long as it is connected. A new definition needs an engineer.",
            ),
            ("WithdrawSkill", self._withdraw, (robot, skill), (), "This client does a skill no longer."),
            ("Accept", self._accept, (execution,), (), "This client does what is asked for, and no other does."),
            (
                "Report",
                self._report,
                (execution, MethodArgument("Progress", int(BuiltinType.DOUBLE), "0 to 1"), message),
                (),
                "Say how far it is.",
            ),
            (
                "Complete",
                self._complete,
                (
                    execution,
                    MethodArgument("ResultNames", _TEXTS, "the results"),
                    MethodArgument("ResultValues", _TEXTS, "their values, e.g. 20, true, left"),
                    message,
                ),
                (),
                "It is done, with these results.",
            ),
            ("Fail", self._fail, (execution, message), (), "It is not done, and will not be."),
        ):
            self._methods.add(OFFERS, name, Role.OPERATOR, work, inputs, outputs, text)

    def show(self, asked: OfferedExecution) -> None:
        """A request is new or has changed."""
        self._show_lists()
        self._projection.then(partial(self._tell, asked, self._wall_ticks()))

    # Methods.

    async def _offer(self, robot: str, skill: str, definition: str) -> Sequence[Any]:
        user = caller()
        try:
            model = self._roster.offer(robot, skill, definition, user.name, user.role.covers(Role.ENGINEER))
        except ConfigInvalid as error:
            problems, lines = [str(one) for one in error.problems], [one.line for one in error.problems]
            raise NotValid(problems[0], (NodeId(0, 0), problems, lines)) from error
        topic = Topic(SERVER_SPACE, model.ns, next(one.id for one in model.skills if one.name == skill))
        self._offers.offer(_session(), user.name, topic)
        return NodeId(topic.ns, topic.id), [], []

    async def _withdraw(self, robot: str, skill: str) -> Sequence[Any]:
        model = self._roster.of_clients(robot, skill)
        topic = Topic(SERVER_SPACE, model.ns, next(one.id for one in model.skills if one.name == skill))
        self._offers.withdraw(_session(), topic)
        return ()

    async def _accept(self, execution: str) -> Sequence[Any]:
        self._offers.accept(_session(), caller().name, _id(execution))
        return ()

    async def _report(self, execution: str, progress: float, message: str) -> Sequence[Any]:
        self._offers.progressed(_session(), caller().name, _id(execution), progress, message[:MOST_TEXT])
        return ()

    async def _complete(self, execution: str, names: list[str], values: list[str], message: str) -> Sequence[Any]:
        execution_id = _id(execution)
        results = read_results(self._offers.skill_of(execution_id), names, values)
        self._offers.complete(_session(), caller().name, execution_id, results, message[:MOST_TEXT])
        return ()

    async def _fail(self, execution: str, message: str) -> Sequence[Any]:
        self._offers.fail(_session(), caller().name, _id(execution), message[:MOST_TEXT])
        return ()

    # Within.

    def _key(self, name: str) -> NodeId:
        return NodeId(self._parts.ns, f"{OFFERS}.{name}")

    def _show_lists(self) -> None:
        columns = list(zip(*[_row(asked) for asked in self._offers.open], strict=True)) or [()] * len(_LISTS)
        for (name, kind), values in zip(_LISTS, columns, strict=True):
            self._projection.write(ValueChanged(self._key(name), kind, tuple(values), 0, self._wall_ticks(), False))

    def _tell(self, asked: OfferedExecution, ticks: int) -> None:
        name = f"{asked.robot}.{asked.skill.name}"
        said = f"{name} is {asked.state}"
        kinds = {argument.name: argument.type for argument in asked.skill.arguments}
        self._events.emit(
            _EVENT,
            source=NodeId(asked.topic.ns, asked.topic.id),
            source_name=name,
            message=f"{said}; {asked.report.message}" if asked.report.message else said,
            severity=_SEVERITY.get(asked.state, 100),
            ticks=ticks,
            fields={
                "Robot": Variant(_TEXT, asked.robot),
                "Skill": Variant(_TEXT, asked.skill.name),
                "ExecutionId": Variant(_TEXT, asked.execution_id.hex()),
                "State": Variant(_TEXT, asked.state),
                "ArgumentNames": Variant(_TEXTS, tuple(asked.arguments)),
                "Arguments": Variant(
                    int(BuiltinType.VARIANT | ARRAY),
                    tuple([Variant(kinds[one], value) for one, value in asked.arguments.items()]),
                ),
                "TakenBy": Variant(_TEXT, asked.taken_by),
                "Until": Variant(_TIME, asked.until),
            },
        )


def _row(asked: OfferedExecution) -> tuple[Any, ...]:
    arguments = json.dumps(dict(asked.arguments), ensure_ascii=False)
    return asked.execution_id.hex(), asked.robot, asked.skill.name, arguments, asked.taken_by, asked.until


def _id(text: str) -> bytes:
    try:
        execution_id = bytes.fromhex(text)
    except ValueError:
        execution_id = b""
    if len(execution_id) != EXECUTION_ID_BYTES:
        raise NotValid(f"{text[:40]!r} is no ExecutionId; it has {2 * EXECUTION_ID_BYTES} hexadecimal digits")
    return execution_id


def _session() -> str:
    session = current_session.get()
    assert session is not None
    return session.key


def _code_of(error: UaFleetError) -> int:
    return NOT_FOUND if isinstance(error, RobotUnknown) else NOT_POSSIBLE
