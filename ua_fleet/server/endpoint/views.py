"""Browse, BrowseNext, TranslateBrowsePathsToNodeIds and RegisterNodes (OPC 10000-4 5.9)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import secrets
from typing import Any

from asyncua import ua
from asyncua.server.address_space import NodeData

from ua_fleet.server.endpoint.context import Context
from ua_fleet.server.endpoint.request import Request, operations
from ua_fleet.server.endpoint.sessions import Session
from ua_fleet.server.endpoint.stack import ObjectIds, Refusal, StatusCodes, ns0, status

__all__ = ["ViewServices"]

_HAS_SUBTYPE = ns0(ObjectIds.HasSubtype)


class ViewServices:
    """OPC 10000-4 5.9, with references handed out in bounded portions."""

    def __init__(self, context: Context) -> None:
        self._context, self._limits = context, context.limits
        self._aspace = context.iserver.aspace

    async def browse(self, request: Request, params: ua.BrowseParameters) -> Any:
        """Browse."""
        nodes = operations(params.NodesToBrowse, self._limits.nodes_per_request)
        view = params.View.ViewId
        if view is not None and not view.is_null():
            raise Refusal(StatusCodes.BadViewIdUnknown)
        portion = self._limits.references_per_node
        if params.RequestedMaxReferencesPerNode:
            portion = min(portion, params.RequestedMaxReferencesPerNode)
        types: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        response = ua.BrowseResponse()
        for description in nodes:
            result = ua.BrowseResult()
            try:
                self._hand_out(request.session, result, self._references(description, types), portion)
            except Refusal as error:
                result.StatusCode = status(error.ua_status)
            response.Results.append(result)
        return response

    def _references(
        self, wanted: ua.BrowseDescription, types: dict[ua.NodeId, frozenset[ua.NodeId]]
    ) -> list[ua.ReferenceDescription]:
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
        if self._aspace.get(reference_type) is None:
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

    def _hand_out(
        self, session: Session, result: ua.BrowseResult, references: list[ua.ReferenceDescription], portion: int
    ) -> None:
        """Put a portion into the result, and what is left behind a continuation point."""
        if len(references) > portion:
            if len(session.continuations) >= self._limits.continuation_points:
                raise Refusal(StatusCodes.BadNoContinuationPoints)
            point = secrets.token_bytes(16)
            session.continuations[point] = [portion, references[portion:]]
            result.ContinuationPoint = ua.ByteString(point)
        result.References = references[:portion]

    async def browse_next(self, request: Request, params: ua.BrowseNextParameters) -> Any:
        """BrowseNext."""
        response = ua.BrowseNextResponse()
        for point in operations(params.ContinuationPoints, self._limits.nodes_per_request):
            result = ua.BrowseResult()
            rest = request.session.continuations.pop(point or b"", None)
            if rest is None:
                result.StatusCode = status(StatusCodes.BadContinuationPointInvalid)
            elif not params.ReleaseContinuationPoints:
                self._hand_out(request.session, result, rest[1], rest[0])
            response.Parameters.Results.append(result)
        return response

    async def translate_browse_paths(self, request: Request, params: ua.TranslateBrowsePathsToNodeIdsParameters) -> Any:
        """TranslateBrowsePathsToNodeIds."""
        types: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        response = ua.TranslateBrowsePathsToNodeIdsResponse()
        for path in operations(params.BrowsePaths, self._limits.nodes_per_request):
            result = ua.BrowsePathResult()
            try:
                for node_id in self._translate(path, types):
                    # 0xFFFFFFFF: the whole path was used (OPC 10000-4 7.6).
                    result.Targets.append(ua.BrowsePathTarget(node_id, ua.Index(0xFFFF_FFFF)))  # pyright: ignore[reportArgumentType]
            except Refusal as error:
                result.StatusCode = status(error.ua_status)
            response.Results.append(result)
        return response

    def _translate(self, path: ua.BrowsePath, types: dict[ua.NodeId, frozenset[ua.NodeId]]) -> list[ua.NodeId]:
        elements = path.RelativePath.Elements
        if self._aspace.get(path.StartingNode) is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        if not elements:
            raise Refusal(StatusCodes.BadNothingToDo)
        if len(elements) > self._limits.browse_path_elements:
            raise Refusal(StatusCodes.BadQueryTooComplex)
        last = elements[-1].TargetName
        if last is None or not last.Name:
            raise Refusal(StatusCodes.BadBrowseNameInvalid)
        current: dict[ua.NodeId, None] = {path.StartingNode: None}
        for element in elements:
            allowed = self._types(element.ReferenceTypeId, include=element.IncludeSubtypes, known=types)
            # A node is visited once for each element, however many ways lead to it.
            current = {
                ref.NodeId: None
                for node_id in current
                for ref in self._node_references(node_id)
                if ref.BrowseName == element.TargetName
                and ref.IsForward != element.IsInverse
                and (allowed is None or ref.ReferenceTypeId in allowed)
            }
            if not current:
                raise Refusal(StatusCodes.BadNoMatch)
        return list(current)

    def _node_references(self, node_id: ua.NodeId) -> list[ua.ReferenceDescription]:
        node: NodeData | None = self._aspace.get(node_id)
        return node.references if node is not None else []

    async def register_nodes(self, request: Request, params: ua.RegisterNodesParameters) -> Any:
        """RegisterNodes: our NodeIds are as fast as any handle."""
        response = ua.RegisterNodesResponse()
        response.Parameters.RegisteredNodeIds = list(operations(params.NodesToRegister, self._limits.nodes_per_request))
        return response

    async def unregister_nodes(self, request: Request, params: ua.UnregisterNodesParameters) -> Any:
        """UnregisterNodes."""
        operations(params.NodesToUnregister, self._limits.nodes_per_request)
        return ua.UnregisterNodesResponse()
