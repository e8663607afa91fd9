"""Call: only what is executable, by whom it may be, with arguments of the right number and type, and not for ever."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import asyncio
import contextvars
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.server.address_space import NodeData

from ua_fleet.server.audit import summary
from ua_fleet.server.endpoint.answers import Answer
from ua_fleet.server.endpoint.audit_events import AuditEvents
from ua_fleet.server.endpoint.context import Context
from ua_fleet.server.endpoint.request import Request, operations
from ua_fleet.server.endpoint.sessions import current_session
from ua_fleet.server.endpoint.stack import (
    GOOD,
    AttributeIds,
    ObjectIds,
    Refusal,
    StatusCodes,
    name_of,
    ns0,
    shown,
    status,
    status_of,
)
from ua_fleet.server.users import current_user

__all__ = ["MethodServices"]

_log = structlog.get_logger("ua_fleet.server")

_ABSTRACT: Final[dict[int, frozenset[int]]] = {
    24: frozenset(range(1, 26)),
    26: frozenset(range(2, 12)),
    27: frozenset((2, 4, 6, 8)),
    28: frozenset((3, 5, 7, 9)),
    29: frozenset((6,)),
}
"""Built-in types that fit BaseDataType, Number, Integer, UInteger and Enumeration (OPC 10000-3 8)."""
_HAS_SUBTYPE = ns0(ObjectIds.HasSubtype)
_HAS_PROPERTY = ns0(ObjectIds.HasProperty)


class _WrongArguments(Refusal):
    """Arguments of wrong types; `results` says which."""

    def __init__(self, results: list[ua.StatusCode]) -> None:
        self.results = results
        super().__init__(StatusCodes.BadInvalidArgument)


class MethodServices:
    """OPC 10000-4 5.12."""

    def __init__(self, context: Context, events: AuditEvents) -> None:
        self._context, self._limits, self._events = context, context.limits, events
        self._aspace = context.iserver.aspace
        self._types: dict[ua.NodeId, frozenset[int]] = {}

    async def call(self, request: Request, params: ua.CallParameters) -> Any:
        """Call: one method after the other, each with a line in the audit log."""
        answer = Answer(ua.CallResponse(), self._limits.response_bytes)
        most = min(self._limits.calls_per_request, self._limits.nodes_per_request)
        for wanted in operations(params.MethodsToCall, most):
            result = await self._call(request, wanted)
            answer.add(
                result,
                lambda code: ua.CallMethodResult(StatusCode=status(code)),
                self._context.misfit,
                partial(shown, wanted.MethodId),
            )
            self._context.statistics.calls += 1
            code = int(result.StatusCode.value)
            self._record(request, wanted, code)
            is_secret = wanted.MethodId in self._context.secret_methods
            self._events.called(request.who, wanted, [] if is_secret else result.OutputArguments or [], code)
            await request.turns.end(answer.size)
        return answer

    def _record(self, request: Request, wanted: ua.CallMethodRequest, code: int) -> None:
        audit = self._context.audit
        arguments = [argument.Value for argument in wanted.InputArguments or []]
        what = {"object": shown(wanted.ObjectId), "method": shown(wanted.MethodId), "value": summary(arguments)}
        if code == StatusCodes.BadServerTooBusy:
            # Who calls too often shall not fill the log either.
            audit.refuse(request.caller, "call", name_of(code), **what)
        else:
            audit.record("call", request.caller, name_of(code), **what)

    async def _call(self, request: Request, wanted: ua.CallMethodRequest) -> ua.CallMethodResult:
        result = ua.CallMethodResult()
        try:
            implementation = self._check(request, wanted)
            self._check_arguments(wanted)
            returned = await self._run(request, implementation, wanted)
            if isinstance(returned, ua.CallMethodResult):
                result = returned
            elif isinstance(returned, ua.StatusCode):
                result.StatusCode = returned
            else:
                result.OutputArguments = returned
        except _WrongArguments as error:
            result.StatusCode = status(error.ua_status)
            result.InputArgumentResults = error.results
        except TimeoutError:
            _log.warning("method took too long", method=shown(wanted.MethodId), limit_s=self._limits.method_s)
            result.StatusCode = status(StatusCodes.BadTimeout)
        except Exception as error:  # noqa: BLE001 - what is no refusal is logged with its traceback
            if (known := status_of(error)) is not None:
                result.StatusCode = status(known)
            else:
                # A mistake in one method must not end the client's connection.
                self._context.mistakes.caught("methods", error, method=shown(wanted.MethodId))
                result.StatusCode = status(StatusCodes.BadInternalError)
        if result.StatusCode.is_good() and not result.InputArgumentResults:
            result.InputArgumentResults = [GOOD] * len(wanted.InputArguments or [])
        return result

    def _check(self, request: Request, wanted: ua.CallMethodRequest) -> Callable[..., Any]:
        """The implementation of a method; raises Refusal where this user may not call it there."""
        owner, method = self._aspace.get(wanted.ObjectId), self._aspace.get(wanted.MethodId)
        if owner is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        if method is None or not any(ref.IsForward and ref.NodeId == wanted.MethodId for ref in owner.references):
            raise Refusal(StatusCodes.BadMethodInvalid)
        if method.call is None:
            raise Refusal(StatusCodes.BadNotImplemented if _is_method(method) else StatusCodes.BadMethodInvalid)
        if not self._flag(wanted.MethodId, AttributeIds.Executable):
            raise Refusal(StatusCodes.BadNotExecutable)
        if wanted.MethodId in self._context.encrypted_methods and not request.encrypted:
            raise Refusal(StatusCodes.BadSecurityModeInsufficient)
        allowed = self._context.may_call(request.user, wanted.MethodId)
        if not allowed or not self._flag(wanted.MethodId, AttributeIds.UserExecutable):
            raise Refusal(StatusCodes.BadUserAccessDenied)
        return method.call

    def _flag(self, node_id: ua.NodeId, attribute: AttributeIds) -> bool:
        variant = self._aspace.read_attribute_value(node_id, attribute).Value
        return variant is not None and variant.Value is True

    def _check_arguments(self, wanted: ua.CallMethodRequest) -> None:
        given = wanted.InputArguments or []
        declared = self._declared(wanted.MethodId)
        if len(given) < len(declared):
            raise Refusal(StatusCodes.BadArgumentsMissing, f"{len(given)} arguments of {len(declared)}")
        if len(given) > len(declared):
            raise Refusal(StatusCodes.BadTooManyArguments, f"{len(given)} arguments instead of {len(declared)}")
        fits = [self._fits(value, argument) for value, argument in zip(given, declared, strict=True)]
        if not all(fits):
            mismatch = status(StatusCodes.BadTypeMismatch)
            raise _WrongArguments([GOOD if fit else mismatch for fit in fits])

    def _declared(self, method_id: ua.NodeId) -> list[Any]:
        """The method's InputArguments."""
        node = self._aspace.get(method_id)
        for ref in node.references if node is not None else ():
            if ref.IsForward and ref.ReferenceTypeId == _HAS_PROPERTY and ref.BrowseName.Name == "InputArguments":
                variant = self._aspace.read_attribute_value(ref.NodeId, AttributeIds.Value).Value
                return list(variant.Value or []) if variant is not None else []
        return []

    def _fits(self, value: ua.Variant, argument: Any) -> bool:
        # A null array has no elements to show that it is one.
        is_array = value.is_array or isinstance(value.Value, list | tuple)
        rank = int(argument.ValueRank)
        shape = (
            (rank == -1 and not is_array)
            or (rank >= 0 and (is_array or value.Value is None))
            or rank == -2
            or (rank == -3 and not value.Dimensions)
        )
        if rank > 1 and value.Dimensions is not None and len(value.Dimensions) != rank:
            shape = False
        types = self._builtin_types(argument.DataType)
        if value.VariantType.value == 0:
            # Only types that have a null may be left out.
            return rank >= 0 or bool(types & {12, 15, 22})
        return shape and value.VariantType.value in types

    def _builtin_types(self, data_type: ua.NodeId) -> frozenset[int]:
        """The built-in types that values of a DataType have on the wire."""
        known = self._types.get(data_type)
        if known is not None:
            return known
        current: ua.NodeId | None = data_type
        found = frozenset[int]()
        for _ in range(50):
            if current is None:
                break
            identifier = current.Identifier
            if current.NamespaceIndex == 0 and isinstance(identifier, int) and identifier <= 29:
                found = _ABSTRACT.get(identifier, frozenset((identifier,)))
                break
            node = self._aspace.get(current)
            parents = (
                ref.NodeId
                for ref in (node.references if node is not None else ())
                if not ref.IsForward and ref.ReferenceTypeId == _HAS_SUBTYPE
            )
            current = next(parents, None)
        self._types[data_type] = found
        return found

    async def _run(self, request: Request, implementation: Callable[..., Any], wanted: ua.CallMethodRequest) -> Any:
        arguments = [wanted.ObjectId, *(wanted.InputArguments or [])]
        token, session = current_user.set(request.user), current_session.set(request.session)
        try:
            async with asyncio.timeout(self._limits.method_s):
                if inspect.iscoroutinefunction(implementation):
                    return await implementation(*arguments)
                context = contextvars.copy_context()
                run: Callable[[], Any] = partial(context.run, implementation, *arguments)
                pool = self._context.iserver.method_service._pool  # noqa: SLF001 - it has no accessor
                return await asyncio.get_running_loop().run_in_executor(pool, run)
        finally:
            current_user.reset(token)
            current_session.reset(session)


def _is_method(node: NodeData) -> bool:
    value = node.attributes.get(AttributeIds.NodeClass)
    variant = value.value.Value if value is not None and value.value is not None else None
    return variant is not None and variant.Value == ua.NodeClass.Method
