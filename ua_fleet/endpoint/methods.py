"""Call: only what is executable, by whom it may be, with arguments of the right number and type, and not for ever.

A connection's requests are served one after the other. A Call of a Method that waits for others, such as a bridge, is
put aside: it is answered when its answer is there, and what the client asks for meanwhile is served.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import asyncio
import contextvars
import inspect
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import structlog
from asyncua import ua
from asyncua.server.address_space import NodeData

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.at_once import within
from ua_fleet.endpoint.audit import summary
from ua_fleet.endpoint.audit_events import AuditEvents
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.data_types import DataTypes
from ua_fleet.endpoint.request import ServiceRequest, operations
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.stack import (
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
from ua_fleet.endpoint.users import current_user

__all__ = ["FoundMethod", "MethodServices"]

_log = structlog.get_logger("ua_fleet.server")

_HAS_COMPONENT = ns0(ObjectIds.HasComponent)
_HAS_SUBTYPE = ns0(ObjectIds.HasSubtype)
_HAS_TYPE = ns0(ObjectIds.HasTypeDefinition)
_HAS_PROPERTY = ns0(ObjectIds.HasProperty)


_RESULT = struct.Struct("<II")
"""StatusCode, and number of InputArgumentResults, of a CallMethodResult."""
_MOST_ASIDE = 16
"""Calls of one session that wait for others."""


class _WrongArguments(Refusal):
    """Arguments of wrong types; `results` says which."""

    def __init__(self, results: list[ua.StatusCode]) -> None:
        self.results = results
        super().__init__(StatusCodes.BadInvalidArgument)


@dataclass(slots=True)
class FoundMethod:
    """The Method that a client means by an Object and a Method."""

    method_id: ua.NodeId
    """The Object's own, where the client has named that of its type."""
    node: NodeData
    declared: Sequence[Any]
    """Its InputArguments."""
    object_text: str
    method_text: str
    """Both as the client has named them, for the log."""
    _call: Callable[..., Any] | None = None
    _is_coroutine: bool = False

    def is_coroutine(self, implementation: Callable[..., Any]) -> bool:
        """Whether what implements it is a coroutine function."""
        if self._call is not implementation:
            self._call, self._is_coroutine = implementation, inspect.iscoroutinefunction(implementation)
        return self._is_coroutine


class MethodServices:
    """OPC 10000-4 5.12."""

    def __init__(self, context: EndpointContext, events: AuditEvents) -> None:
        self._context, self._limits, self._events = context, context.limits, events
        self._aspace = context.iserver.aspace
        self._types = DataTypes(self._aspace)
        self._aside: set[asyncio.Task[None]] = set()

    async def call(self, request: ServiceRequest, params: ua.CallParameters) -> Any:
        """Call: one method after the other, each with a line in the audit log; None where it is answered later."""
        most = min(self._limits.calls_per_request, self._limits.nodes_per_request)
        calls = operations(params.MethodsToCall, most)
        if len(calls) == 1 and self.waits(calls[0].MethodId):
            self._put_aside(request, calls[0])
            return None
        answer = ArrayResponse(ua.CallResponse, self._limits.response_bytes)
        for wanted in calls:
            await self.add(request, wanted, answer)
            if request.turns.is_due(answer.size):
                await request.turns.end(answer.size)
        return answer

    def waits(self, method_id: ua.NodeId) -> bool:
        """Whether a Call of this Method alone is answered later."""
        return method_id in self._context.waiting_methods

    async def add(
        self,
        request: ServiceRequest,
        wanted: ua.CallMethodRequest,
        answer: ArrayResponse,
        known: FoundMethod | None = None,
    ) -> None:
        """Call a method, add its result, and tell of it.

        Args:
            request: whose it is.
            wanted: the call.
            answer: gets the result.
            known: which Method it is, where that is known and is so now.
        """
        found: FoundMethod | Refusal
        try:
            found = known or self.find(wanted)
        except Refusal as error:
            found = error
        result, reason = await self._call(request, wanted, found)
        if (plain := _plain_bytes(result)) is not None and len(plain) <= answer.left:
            answer.add_bytes(plain)
        else:
            answer.add(
                result,
                lambda code: ua.CallMethodResult(StatusCode=status(code)),
                self._context.misfit,
                partial(shown, wanted.MethodId),
            )
        if request.wants_reasons:
            answer.explain(reason)
        self._context.statistics.calls += 1
        code = int(result.StatusCode.value)
        if wanted.MethodId in self._context.frequent_methods and code != StatusCodes.BadUserAccessDenied:
            return
        method_id = wanted.MethodId if isinstance(found, Refusal) else found.method_id
        secret = self._context.secret_inputs
        is_secret = wanted.MethodId in secret or method_id in secret
        arguments = [] if is_secret else wanted.InputArguments or []
        self._record(request, wanted, found, arguments, code)
        if self._events.wanted:
            outputs = [] if method_id in self._context.secret_methods else result.OutputArguments or []
            told = ua.CallMethodRequest(wanted.ObjectId, wanted.MethodId, arguments)
            self._events.called(request.who, told, outputs, code)

    def _put_aside(self, request: ServiceRequest, wanted: ua.CallMethodRequest) -> None:
        session = request.session
        if session.calls_aside >= _MOST_ASIDE:
            raise Refusal(StatusCodes.BadTooManyOperations, f"{session.calls_aside} calls wait for their answers")
        session.calls_aside += 1
        task = asyncio.create_task(self._answer_later(request, wanted), name="call")
        self._aside.add(task)
        task.add_done_callback(self._aside.discard)

    async def _answer_later(self, request: ServiceRequest, wanted: ua.CallMethodRequest) -> None:
        session, link = request.session, request.session.link
        try:
            with self._context.mistakes.guard("services", service="Call"):
                answer = ArrayResponse(ua.CallResponse, self._limits.response_bytes)
                await self.add(request, wanted, answer)
                if link is not None and session.link is link:
                    link.respond(answer, request.handle, request.request_id)
        finally:
            session.calls_aside -= 1

    async def close(self) -> None:
        """Give up the calls that are not answered yet."""
        for task in list(self._aside):
            task.cancel()
        await asyncio.gather(*self._aside, return_exceptions=True)

    def _record(
        self,
        request: ServiceRequest,
        wanted: ua.CallMethodRequest,
        found: FoundMethod | Refusal,
        arguments: Sequence[Any],
        code: int,
    ) -> None:
        audit = self._context.audit
        if isinstance(found, Refusal):
            what = {"object": shown(wanted.ObjectId), "method": shown(wanted.MethodId)}
        else:
            what = {"object": found.object_text, "method": found.method_text}
        what["value"] = summary([argument.Value for argument in arguments])
        if code == StatusCodes.BadServerTooBusy:
            # Who calls too often shall not fill the log either.
            audit.refuse(request.caller, "call", name_of(code), **what)
        else:
            audit.record("call", request.caller, name_of(code) if code else "Good", **what)

    async def _call(
        self, request: ServiceRequest, wanted: ua.CallMethodRequest, found: FoundMethod | Refusal
    ) -> tuple[ua.CallMethodResult, str]:
        """The result of a call, and why a Method that may be called has refused it; empty where it has not."""
        result, checked, reason = ua.CallMethodResult(), False, ""
        try:
            if isinstance(found, Refusal):
                raise found
            implementation = self._check(request, found)
            self._check_arguments(found.declared, wanted)
            checked = True
            returned = await self._run(request, found, implementation, wanted)
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
                reason = "" if isinstance(error, Refusal) else str(error)
            else:
                # A mistake in one method must not end the client's connection.
                self._context.mistakes.caught("methods", error, method=shown(wanted.MethodId))
                result.StatusCode = status(StatusCodes.BadInternalError)
        if checked and not result.InputArgumentResults:
            result.InputArgumentResults = [GOOD] * len(wanted.InputArguments or [])
        return result, reason

    def find(self, wanted: ua.CallMethodRequest) -> FoundMethod:
        """The Method that is called; raises Refusal where there is none."""
        method_id = self._method(wanted)
        method = self._aspace[method_id]
        held = self.arguments_of(method)
        variant = held.value.Value if held is not None and held.value is not None else None
        declared = list(variant.Value or []) if variant is not None else []
        return FoundMethod(method_id, method, declared, shown(wanted.ObjectId), shown(wanted.MethodId))

    def _method(self, wanted: ua.CallMethodRequest) -> ua.NodeId:
        """The Method of the Object; a client may also name that of the Object's type (OPC 10000-4 5.12.2)."""
        owner, method = self._aspace.get(wanted.ObjectId), self._aspace.get(wanted.MethodId)
        if owner is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        if method is None or not _is_method(method):
            raise Refusal(StatusCodes.BadMethodInvalid)
        if any(ref.IsForward and ref.NodeId == wanted.MethodId for ref in owner.references):
            named: ua.NodeId = wanted.MethodId
            return named
        of_types = {ref.NodeId: ref.BrowseName for type_ in self._types_of(owner) for ref in _components(type_)}
        name = of_types.get(wanted.MethodId)
        own: list[ua.NodeId] = [ref.NodeId for ref in _components(owner) if ref.BrowseName == name]
        if name is None or not own:
            raise Refusal(StatusCodes.BadMethodInvalid)
        return own[0]

    def _types_of(self, owner: NodeData) -> Iterator[NodeData]:
        """An Object's type, and the types that this one is a subtype of."""
        node: NodeData | None = owner
        reference, forward = _HAS_TYPE, True
        while node is not None:
            above = (
                ref.NodeId for ref in node.references if ref.ReferenceTypeId == reference and ref.IsForward == forward
            )
            node = self._aspace.get(next(above, ua.NodeId()))
            if node is not None:
                yield node
            reference, forward = _HAS_SUBTYPE, False

    def _check(self, request: ServiceRequest, found: FoundMethod) -> Callable[..., Any]:
        """The implementation of a method; raises Refusal where this user may not call it there."""
        method_id, method = found.method_id, found.node
        if not _flag(found, AttributeIds.Executable):
            raise Refusal(StatusCodes.BadNotExecutable)
        if method.call is None:
            raise Refusal(StatusCodes.BadNotImplemented)
        if method_id in self._context.encrypted_methods and not request.encrypted:
            raise Refusal(StatusCodes.BadSecurityModeInsufficient)
        allowed = self._context.may_call(request.user, method_id)
        if not allowed or not _flag(found, AttributeIds.UserExecutable):
            raise Refusal(StatusCodes.BadUserAccessDenied)
        implementation: Callable[..., Any] = method.call
        return implementation

    def _check_arguments(self, declared: Sequence[Any], wanted: ua.CallMethodRequest) -> None:
        given = wanted.InputArguments or []
        if len(given) < len(declared):
            raise Refusal(StatusCodes.BadArgumentsMissing, f"{len(given)} arguments of {len(declared)}")
        if len(given) > len(declared):
            raise Refusal(StatusCodes.BadTooManyArguments, f"{len(given)} arguments instead of {len(declared)}")
        fits = [self._fits(value, argument) for value, argument in zip(given, declared, strict=True)]
        if not all(fits):
            mismatch = status(StatusCodes.BadTypeMismatch)
            raise _WrongArguments([GOOD if fit else mismatch for fit in fits])

    def arguments_of(self, method: NodeData) -> Any:
        """What holds the InputArguments of a method; None where it has none."""
        for ref in method.references:
            if ref.IsForward and ref.ReferenceTypeId == _HAS_PROPERTY and ref.BrowseName.Name == "InputArguments":
                node = self._aspace.get(ref.NodeId)
                return None if node is None else node.attributes.get(AttributeIds.Value)
        return None

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
        if rank >= 1 and value.Dimensions is not None and len(value.Dimensions) != rank:
            shape = False
        types = self._types.builtin_types(argument.DataType)
        if value.VariantType.value == 0:
            # Only types that have a null may be left out.
            return rank >= 0 or bool(types & {12, 15, 22})
        return shape and value.VariantType.value in types

    async def _run(
        self,
        request: ServiceRequest,
        found: FoundMethod,
        implementation: Callable[..., Any],
        wanted: ua.CallMethodRequest,
    ) -> Any:
        arguments = [wanted.ObjectId, *(wanted.InputArguments or [])]
        token, session = current_user.set(request.user), current_session.set(request.session)
        try:
            if found.is_coroutine(implementation):
                return await within(self._limits.method_s, implementation(*arguments))
            async with asyncio.timeout(self._limits.method_s):
                context = contextvars.copy_context()
                run: Callable[[], Any] = partial(context.run, implementation, *arguments)
                pool = self._context.iserver.method_service._pool  # noqa: SLF001 - it has no accessor
                return await asyncio.get_running_loop().run_in_executor(pool, run)
        finally:
            current_user.reset(token)
            current_session.reset(session)


def _components(node: NodeData) -> Iterator[ua.ReferenceDescription]:
    return (ref for ref in node.references if ref.IsForward and ref.ReferenceTypeId == _HAS_COMPONENT)


def _plain_bytes(result: Any) -> bytes | None:
    """A result without outputs, whose arguments are right, as bytes; None for any other one."""
    arguments = result.InputArgumentResults
    if result.OutputArguments != [] or result.InputArgumentDiagnosticInfos != [] or not isinstance(arguments, list):
        return None
    if any(each is not GOOD for each in arguments):
        return None
    return _RESULT.pack(result.StatusCode.value, len(arguments)) + bytes(4 * len(arguments) + 8)


def _flag(found: FoundMethod, attribute: AttributeIds) -> bool:
    """Whether an attribute of a method is true."""
    held = found.node.attributes.get(attribute)
    if held is None:
        return False
    value = held.value_callback(found.method_id, attribute) if held.value_callback else held.value
    variant = value.Value if value is not None else None
    return variant is not None and variant.Value is True


def _is_method(node: NodeData) -> bool:
    value = node.attributes.get(AttributeIds.NodeClass)
    variant = value.value.Value if value is not None and value.value is not None else None
    return variant is not None and variant.Value == ua.NodeClass.Method
