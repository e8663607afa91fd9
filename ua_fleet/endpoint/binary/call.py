"""Call (OPC 10000-4 5.12.2) from the bytes of a request.

The bytes of an Object's and a Method's NodeIds are the key to the Method that they name and its InputArguments; numbers
and texts behind them are decoded in one pass. All else is scanned and decoded by asyncua. The whole request is decoded
before the first Method is called. `methods` has the rules, and asks anew at each call who may call what.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from typing import Any

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.decoders import decode_plain_arguments
from ua_fleet.endpoint.binary.operations import OperationReader
from ua_fleet.endpoint.binary.targets import LONGEST_KEY, Targets, node_id_bytes
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.methods import FoundMethod, MethodServices
from ua_fleet.endpoint.request import ServiceRequest
from ua_fleet.endpoint.scan import Scan
from ua_fleet.endpoint.stack import Refusal

__all__ = ["CallPlan"]


class _Target:
    """A Method of an Object, and by what it was found.

    Nothing is kept of the Method's own references: one that all skills share has as many as there are skills. Its
    InputArguments are made before it can be called, and go with a node, which `Targets` counts.
    """

    __slots__ = ("_arguments", "_index", "_owner", "_reference", "found", "method_id", "object_id")

    def __init__(self, wanted: ua.CallMethodRequest, owner: Any, index: int, found: FoundMethod, held: Any) -> None:
        """Remember a Method.

        Args:
            wanted: a call of it.
            owner: the Object.
            index: which of the Object's references leads to it.
            found: the Method.
            held: holds its InputArguments; None where it has none.
        """
        self.object_id, self.method_id, self.found = wanted.ObjectId, wanted.MethodId, found
        self._owner, self._index, self._reference = owner, index, owner.references[index]
        self._arguments = None if held is None else (held, held.value)

    @property
    def is_as_it_was(self) -> bool:
        """Whether the Object still has the Method, and this one its arguments."""
        references, arguments = self._owner.references, self._arguments
        return (
            self._index < len(references)
            and references[self._index] is self._reference
            and (arguments is None or arguments[0].value is arguments[1])
        )


_Operation = tuple[_Target | None, ua.CallMethodRequest]


class CallPlan:
    """Calls for all sessions of one server."""

    def __init__(self, context: EndpointContext, methods: MethodServices) -> None:
        self._aspace: Any = context.iserver.aspace
        self._limits, self._methods = context.limits, methods
        self._operations = OperationReader(ua.CallMethodRequest, context.limits)
        self._targets = Targets[_Target](context.iserver.aspace)

    async def serve(self, request: ServiceRequest, data: bytes, start: int) -> ArrayResponse | None:
        """The response; None for a request that is refused as a whole, or answered later: others know how.

        Args:
            request: whose it is.
            data: the whole request.
            start: where its parameters begin.

        Raises:
            Refusal: an operation is no valid encoding, or the request is not to go on.
        """
        begun = self._operations.begin(data, start)
        limits, turns = self._limits, request.turns
        if begun is None or begun[1][0] > limits.calls_per_request:
            return None
        scan, (count,) = begun
        removed = self._targets.removed
        decoded = await self._operations.all(scan, count, turns, self._decoded)
        if count == 1 and self._methods.waits(decoded[0][1].MethodId):
            return None
        answer = ArrayResponse(ua.CallResponse, limits.response_bytes)
        for target, wanted in decoded:
            is_known = target is not None and removed == self._targets.removed and target.is_as_it_was
            await self._methods.add(request, wanted, answer, target.found if target is not None and is_known else None)
            if turns.is_due(answer.size):
                await turns.end(answer.size)
        return answer

    def _decoded(self, scan: Scan) -> _Operation:
        """The next operation."""
        data, position = scan.data, scan.position
        middle = position + node_id_bytes(data, position)
        end = middle + node_id_bytes(data, middle)
        target = self._targets.known().get(data[position:end])
        if target is not None and not target.is_as_it_was:
            target = None  # it is remembered anew
        if target is not None:
            arguments = self._operations.rest(scan, end, decode_plain_arguments)
            if arguments is not None:
                return target, ua.CallMethodRequest(target.object_id, target.method_id, arguments)
        wanted = self._operations.whole(scan)
        if position < middle < end <= position + LONGEST_KEY:
            self._remember(data[position:end], wanted)
        return target, wanted

    def _remember(self, key: bytes, wanted: ua.CallMethodRequest) -> None:
        """Know next time which Method this is, where it is the Object's own and named as that."""
        try:
            found = self._methods.find(wanted)
        except Refusal:
            return
        owner = self._aspace[wanted.ObjectId]
        index = next(
            (at for at, each in enumerate(owner.references) if each.IsForward and each.NodeId == wanted.MethodId), None
        )
        if index is not None:
            self._targets.known()[key] = _Target(wanted, owner, index, found, self._methods.arguments_of(found.node))
