"""Browse, BrowseNext, TranslateBrowsePathsToNodeIds and RegisterNodes (OPC 10000-4 5.9)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import dataclasses
import secrets
from functools import partial
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import NodeData

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.encoders import encode
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.request import ServiceRequest, operations
from ua_fleet.endpoint.sessions import Session
from ua_fleet.endpoint.stack import (
    DECODE_ERRORS,
    AttributeIds,
    ObjectIds,
    Refusal,
    StatusCodes,
    ns0,
    shown,
    status,
)
from ua_fleet.endpoint.turns import Turns

__all__ = ["BrowsePortions", "ViewServices"]

_HAS_SUBTYPE = ns0(ObjectIds.HasSubtype)
_RESULT_BYTES: Final = 28
"""StatusCode, ContinuationPoint and number of references of a BrowseResult."""
_NO_POINT: Final = bytes(4) + b"\xff\xff\xff\xff"
"""StatusCode Good, and no ContinuationPoint."""


_ALL_FIELDS: Final = 63
"""BrowseResultMask.All."""
_FIELDS: Final = {
    1: ("ReferenceTypeId", ua.NodeId()),
    2: ("IsForward", False),
    4: ("NodeClass", ua.NodeClass.Unspecified),
    8: ("BrowseName", ua.QualifiedName()),
    16: ("DisplayName", ua.LocalizedText()),
    32: ("TypeDefinition", ua.ExpandedNodeId()),
}
"""Bits of BrowseResultMask: the field, and what stands in its place where it is not wanted (OPC 10000-4 7.5)."""


def _masked(ref: ua.ReferenceDescription, mask: int) -> ua.ReferenceDescription:
    """A reference with the fields that a client wants."""
    unwanted: dict[str, Any] = {name: null for bit, (name, null) in _FIELDS.items() if not mask & bit}
    return dataclasses.replace(ref, **unwanted)


class BrowsePortions:
    """The BrowseResults of one response: what does not fit into it waits at a continuation point."""

    def __init__(self, session: Session, kind: Any, context: EndpointContext) -> None:
        self.answer = ArrayResponse(kind, context.limits.response_bytes)
        self._session, self._misfit = session, context.misfit
        self._points = context.limits.continuation_points
        self._made: set[bytes] = set()
        """Continuation points of this response."""
        self._known: dict[tuple[int, int], tuple[ua.ReferenceDescription, bytes]] = {}

    def add(self, references: list[ua.ReferenceDescription], portion: int, mask: int) -> None:
        """Add a result with at most `portion` references, and a continuation point for the rest.

        Args:
            references: those of the result.
            portion: how many of them the client takes at a time.
            mask: which of their fields it wants, as bits of BrowseResultMask.

        Raises:
            Refusal: there is a rest, and no continuation point for it.
        """
        parts: list[bytes] = []
        size, taken = _RESULT_BYTES, 0
        for ref in references[:portion]:
            data = self._encode(ref, mask)
            if size + len(data) > self.answer.left:
                break
            size += len(data)
            taken += 1
            if data:
                parts.append(data)
        point = b""
        if taken < len(references):
            self._make_room()
            point = secrets.token_bytes(16)
            self._made.add(point)
            self._session.continuations[point] = [portion, references[taken:], mask]
        length = (len(point) or -1).to_bytes(4, "little", signed=True)
        head = (bytes(4), length, point, len(parts).to_bytes(4, "little"))
        data = b"".join((*head, *parts))
        if parts:
            self.answer.add_bytes(data)
        else:
            self.answer.add_small(data)

    def _make_room(self) -> None:
        """Free the oldest continuation point of an earlier request, if there are too many (OPC 10000-4 7.9)."""
        held = self._session.continuations
        if len(held) < self._points:
            return
        earlier = next((point for point in held if point not in self._made), None)
        if earlier is None:
            raise Refusal(StatusCodes.BadNoContinuationPoints)
        del held[earlier]

    def _encode(self, ref: ua.ReferenceDescription, mask: int) -> bytes:
        """A reference as bytes, which are made once for a response; empty for one that cannot be encoded."""
        known = self._known.get((id(ref), mask))
        if known is not None:
            return known[1]
        try:
            data = encode(ref if mask & _ALL_FIELDS == _ALL_FIELDS else _masked(ref, mask))
        except DECODE_ERRORS as error:
            self._misfit(f"a reference to {shown(ref.NodeId)}", error)
            data = b""
        self._known[id(ref), mask] = ref, data
        return data

    def whole(self, references: list[ua.ReferenceDescription], mask: int) -> bytes | None:
        """A result with all references, as bytes; None where one of them cannot be encoded."""
        parts = [self._encode(ref, mask) for ref in references]
        if not all(parts):
            return None
        return b"".join((_NO_POINT, len(parts).to_bytes(4, "little"), *parts))

    def add_whole(self, data: bytes) -> bool:
        """Add what `whole` has made, if there is room for it."""
        size = len(data) + _RESULT_BYTES - len(_NO_POINT) - 4
        if size > self.answer.left and len(data) > len(_NO_POINT) + 4:
            return False
        (self.answer.add_bytes if size > _RESULT_BYTES else self.answer.add_small)(data)
        return True

    def refuse(self, code: int) -> None:
        """Add a result without references."""
        self.answer.add_small(encode(ua.BrowseResult(StatusCode=status(code))))


class ViewServices:
    """OPC 10000-4 5.9, with references handed out in bounded portions."""

    def __init__(self, context: EndpointContext) -> None:
        self._context, self._limits = context, context.limits
        self._aspace = context.iserver.aspace

    async def browse(self, request: ServiceRequest, params: ua.BrowseParameters) -> Any:
        """Browse."""
        nodes = operations(params.NodesToBrowse, self._limits.nodes_per_request)
        view = params.View.ViewId
        if view is not None and not view.is_null():
            raise Refusal(StatusCodes.BadViewIdUnknown)
        portion = self._limits.references_per_node
        if params.RequestedMaxReferencesPerNode:
            portion = min(portion, params.RequestedMaxReferencesPerNode)
        types: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        portions = BrowsePortions(request.session, ua.BrowseResponse, self._context)
        for description in nodes:
            try:
                portions.add(self.references(description, types), portion, int(description.ResultMask))
            except Refusal as error:
                portions.refuse(error.ua_status)
            await request.turns.end(portions.answer.size)
        return portions.answer

    def references(
        self, wanted: ua.BrowseDescription, types: dict[ua.NodeId, frozenset[ua.NodeId]]
    ) -> list[ua.ReferenceDescription]:
        """The references that a client wishes for; `types` are those that have been looked up. Raises Refusal."""
        node = self._aspace.get(wanted.NodeId)
        if node is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        if wanted.BrowseDirection not in (
            ua.BrowseDirection.Forward,
            ua.BrowseDirection.Inverse,
            ua.BrowseDirection.Both,
        ):
            raise Refusal(StatusCodes.BadBrowseDirectionInvalid)
        allowed = self._types(wanted.ReferenceTypeId, include=wanted.IncludeSubtypes, known=types)
        both = wanted.BrowseDirection == ua.BrowseDirection.Both
        forward = wanted.BrowseDirection == ua.BrowseDirection.Forward
        mask = int(wanted.NodeClassMask)
        return [
            ref
            for ref in node.references
            if (both or ref.IsForward == forward)
            and (allowed is None or ref.ReferenceTypeId in allowed)
            and (not mask or mask & int(ref.NodeClass))
        ]

    def _types(
        self, reference_type: ua.NodeId | None, *, include: bool, known: dict[ua.NodeId, frozenset[ua.NodeId]]
    ) -> frozenset[ua.NodeId] | None:
        """The reference types that fit, or None for all."""
        if reference_type is None or reference_type.is_null():
            return None
        if not self._is_reference_type(reference_type):
            raise Refusal(StatusCodes.BadReferenceTypeIdInvalid)
        if not include:
            return frozenset((reference_type,))
        if reference_type not in known:
            found = {reference_type}
            open_types = [reference_type]
            while open_types:
                node = self._aspace.get(open_types.pop())
                for ref in node.references if node is not None else ():
                    if ref.IsForward and ref.ReferenceTypeId == _HAS_SUBTYPE and ref.NodeId not in found:
                        found.add(ref.NodeId)
                        open_types.append(ref.NodeId)
            known[reference_type] = frozenset(found)
        return known[reference_type]

    def _is_reference_type(self, node_id: ua.NodeId) -> bool:
        variant = self._aspace.read_attribute_value(node_id, AttributeIds.NodeClass).Value
        return variant is not None and variant.Value == ua.NodeClass.ReferenceType

    async def browse_next(self, request: ServiceRequest, params: ua.BrowseNextParameters) -> Any:
        """BrowseNext."""
        portions = BrowsePortions(request.session, ua.BrowseNextResponse, self._context)
        for point in operations(params.ContinuationPoints, self._limits.nodes_per_request):
            rest = request.session.continuations.pop(point or b"", None)
            if rest is None:
                portions.refuse(StatusCodes.BadContinuationPointInvalid)
            elif params.ReleaseContinuationPoints:
                portions.add([], 0, 0)
            else:
                portions.add(rest[1], rest[0], rest[2])
            await request.turns.end(portions.answer.size)
        return portions.answer

    async def translate_browse_paths(
        self, request: ServiceRequest, params: ua.TranslateBrowsePathsToNodeIdsParameters
    ) -> Any:
        """TranslateBrowsePathsToNodeIds."""
        types: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        answer = ArrayResponse(ua.TranslateBrowsePathsToNodeIdsResponse, self._limits.response_bytes)
        for path in operations(params.BrowsePaths, self._limits.nodes_per_request):
            result = ua.BrowsePathResult()
            try:
                for node_id in await self._translate(path, types, request.turns):
                    # 0xFFFFFFFF: the whole path was used (OPC 10000-4 7.6).
                    result.Targets.append(ua.BrowsePathTarget(node_id, ua.Index(0xFFFF_FFFF)))  # pyright: ignore[reportArgumentType]
            except Refusal as error:
                result.StatusCode = status(error.ua_status)
            answer.add(
                result,
                lambda code: ua.BrowsePathResult(StatusCode=status(code)),
                self._context.misfit,
                partial(shown, path.StartingNode),
            )
            await request.turns.end(answer.size)
        return answer

    async def _translate(
        self, path: ua.BrowsePath, types: dict[ua.NodeId, frozenset[ua.NodeId]], turns: Turns
    ) -> list[ua.NodeId]:
        elements = path.RelativePath.Elements
        if self._aspace.get(path.StartingNode) is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        if not elements:
            raise Refusal(StatusCodes.BadNothingToDo)
        if len(elements) > self._limits.browse_path_elements:
            raise Refusal(StatusCodes.BadQueryTooComplex)
        if any(element.TargetName is None or not element.TargetName.Name for element in elements):
            raise Refusal(StatusCodes.BadBrowseNameInvalid)
        current: dict[ua.NodeId, None] = {path.StartingNode: None}
        for element in elements:
            allowed = self._types(element.ReferenceTypeId, include=element.IncludeSubtypes, known=types)
            # A node is visited once for each element, however many ways lead to it.
            found: dict[ua.NodeId, None] = {}
            for node_id in current:
                for ref in self._node_references(node_id):
                    if (
                        ref.BrowseName == element.TargetName
                        and ref.IsForward != element.IsInverse
                        and (allowed is None or ref.ReferenceTypeId in allowed)
                    ):
                        found[ref.NodeId] = None
                if turns.over:
                    await turns.end()
            current = found
            if not current:
                raise Refusal(StatusCodes.BadNoMatch)
        return list(current)

    def _node_references(self, node_id: ua.NodeId) -> list[ua.ReferenceDescription]:
        node: NodeData | None = self._aspace.get(node_id)
        return node.references if node is not None else []

    async def register_nodes(self, request: ServiceRequest, params: ua.RegisterNodesParameters) -> Any:
        """RegisterNodes: our NodeIds are as fast as any handle."""
        response = ua.RegisterNodesResponse()
        response.Parameters.RegisteredNodeIds = list(operations(params.NodesToRegister, self._limits.nodes_per_request))
        return response

    async def unregister_nodes(self, request: ServiceRequest, params: ua.UnregisterNodesParameters) -> Any:
        """UnregisterNodes."""
        operations(params.NodesToUnregister, self._limits.nodes_per_request)
        return ua.UnregisterNodesResponse()
