"""Methods with plain arguments, so that any client's call dialog can fill them in.

All end with ReturnStatus and Message. A StatusCode that is Bad says that the call itself was not allowed or not well
formed; what could not be done has a ReturnStatus above 0, and a Message that says why:

    0 done   1 there is no such thing   2 not valid   3 not possible now   4 cannot be recorded
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Final, NamedTuple

import structlog
from asyncua import ua

from ua_fleet.endpoint.convert import fleet_variant, raw_id, to_variant
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.stack import Refusal
from ua_fleet.endpoint.users import Role, User, current_user
from ua_fleet.errors import AccessRefused, StorageUnavailable, UaFleetError
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.values import ARRAY, BuiltinType, NodeId, StatusCode

__all__ = [
    "DONE",
    "NOT_FOUND",
    "NOT_POSSIBLE",
    "NOT_RECORDED",
    "NOT_VALID",
    "MethodArgument",
    "MethodFactory",
    "NotValid",
    "Noted",
    "caller",
]

DONE: Final = 0
NOT_FOUND: Final = 1
NOT_VALID: Final = 2
NOT_POSSIBLE: Final = 3
NOT_RECORDED: Final = 4

MOST_ITEMS: Final = 1000
"""Of one array."""
MOST_MESSAGE: Final = 8000
MOST_LOGGED: Final = 500
"""Characters of why something was not done."""
_TEXT: Final = int(BuiltinType.STRING)
_FLAG: Final = int(BuiltinType.BOOLEAN)
_COUNT: Final = int(BuiltinType.UINT64)
_NODE: Final = int(BuiltinType.NODE_ID)
_TIME: Final = int(BuiltinType.DATETIME)

_log: Any = structlog.get_logger("ua_fleet.server")


class Noted(NamedTuple):
    """Outputs of what was done, with a Message that says what to know of them."""

    outputs: Sequence[Any]
    message: str


Work = Callable[..., Awaitable[Sequence[Any] | Noted]]
"""Takes the arguments as plain values; gives the outputs before ReturnStatus."""


class MethodArgument(NamedTuple):
    """An argument of a Method."""

    name: str
    type: int
    """Type code."""
    description: str


class NotValid(UaFleetError):
    """What was given is not valid; some outputs say why."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Correct what the outputs name."

    def __init__(self, message: str, outputs: Sequence[Any] | None = None) -> None:
        self.outputs = outputs
        super().__init__(message)


_RETURNED: Final = (
    MethodArgument(
        "ReturnStatus", int(BuiltinType.UINT64), "0 done, 1 not found, 2 not valid, 3 not possible, 4 not recorded"
    ),
    MethodArgument("Message", _TEXT, "why it was not done"),
)


class MethodFactory:
    """Makes such Methods of Objects that are there."""

    def __init__(self, server: HardenedServer, parts: NodeFactory, code_of: Callable[[UaFleetError], int]) -> None:
        """Prepare to make Methods.

        Args:
            server: calls them.
            parts: of the fleet whose Objects have them.
            code_of: the ReturnStatus of what one of them has raised, where it is not plain from the error itself.
        """
        self._server, self._parts, self._code_of = server, parts, code_of

    def add(
        self,
        owner: str,
        name: str,
        role: Role,
        work: Work,
        inputs: Sequence[MethodArgument],
        outputs: Sequence[MethodArgument],
        description: str = "",
    ) -> ua.NodeId:
        """A Method that users of a role may call."""
        node = self._parts.method(
            owner,
            name,
            [_declared(one) for one in inputs],
            [_declared(one) for one in (*outputs, *_RETURNED)],
            description or f"{name} of {owner}",
        )

        async def owned(_parent: ua.NodeId, *arguments: Any) -> Sequence[Any] | Noted:
            return await work(*arguments)

        self._link(node, name, role, owned, outputs)
        return node

    def share(
        self, method: ua.NodeId, name: str, role: Role, work: Work, outputs: Sequence[MethodArgument] = ()
    ) -> None:
        """A Method of a type, which has its arguments in the nodeset; `work` gets the NodeId of the Object first."""
        self._link(method, name, role, work, outputs)

    def _link(self, node: ua.NodeId, name: str, role: Role, work: Work, outputs: Sequence[MethodArgument]) -> None:
        async def call(parent: ua.NodeId, *arguments: ua.Variant) -> list[ua.Variant]:
            code, message = DONE, ""
            values: Sequence[Any] = [_nothing(output.type) for output in outputs]
            try:
                done = await work(parent, *[_plain(argument) for argument in arguments])
                values, message = (done.outputs, done.message) if isinstance(done, Noted) else (done, "")
            except UaFleetError as error:
                code, message = self._status_of(error), str(error)[:MOST_MESSAGE]
                values = (error.outputs if isinstance(error, NotValid) else None) or values
                _log.warning(
                    "not done", method=name, by=caller().name, reason="; ".join(message.splitlines())[:MOST_LOGGED]
                )
            return [
                to_variant(output.type, value)
                for output, value in zip((*outputs, *_RETURNED), (*values, code, message), strict=True)
            ]

        self._server.link_method(self._server.get_node(node), call)
        self._server.require_role(node, role)

    def _status_of(self, error: UaFleetError) -> int:
        if isinstance(error, Refusal | AccessRefused):
            raise error
        if isinstance(error, NotValid):
            return NOT_VALID
        return NOT_RECORDED if isinstance(error, StorageUnavailable) else self._code_of(error)


def caller() -> User:
    """The user who calls, within a Method."""
    user = current_user.get()
    assert user is not None
    return user


def _declared(argument: MethodArgument) -> ua.Argument:
    is_array = bool(argument.type & ARRAY)
    return ua.Argument(
        Name=ua.String(argument.name),
        DataType=raw_id(argument.type & 0x3F),
        ValueRank=ua.Int32(1 if is_array else -1),
        ArrayDimensions=[ua.UInt32(0)] if is_array else [],
        Description=ua.LocalizedText(argument.description),
    )


def _plain(argument: ua.Variant) -> Any:
    """An argument as a plain value; a null is what is empty of its kind."""
    kind, value = fleet_variant(argument)
    if kind & ARRAY or isinstance(value, tuple | list):
        if len(value or ()) > MOST_ITEMS:
            raise NotValid(f"an array has at most {MOST_ITEMS} items here")
        return [item if item is not None else "" for item in value or ()]
    return "" if value is None else value


def _nothing(kind: int) -> Any:
    if kind & ARRAY:
        return []
    return {_TEXT: "", _FLAG: False, _NODE: NodeId(0, 0), _TIME: None, _COUNT: 0}.get(kind, 0.0)
