"""Browse (OPC 10000-4 5.9.2): what a node's references are for one wish, encoded once.

The bytes of a BrowseDescription are the key to the bytes of its result, for as long as the node has the references that
it had then and no node comes or goes. All else is looked up by `views`, which has the rules.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import struct
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.operations import OperationReader
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.request import ServiceRequest
from ua_fleet.endpoint.scan import Scan, step_of
from ua_fleet.endpoint.stack import Refusal
from ua_fleet.endpoint.views import BrowsePortions, ViewServices

__all__ = ["BrowsePlan"]

_NO_VIEW: Final = b"\x00\x00"
_HEAD: Final = struct.Struct("<2sqIIi")
"""ViewId, Timestamp and ViewVersion of no view; RequestedMaxReferencesPerNode; number of NodesToBrowse."""
_VIEW_MEMORY: Final = step_of(ua.ViewDescription).memory
_MOST_REFERENCES: Final = 1_000
"""Of a result that is kept."""
_MOST_BYTES: Final = 4 * 1024 * 1024
"""Of all results that are kept; the references beside them take about ten times as much."""
_MOST_RESULTS: Final = 32_768


class _Result:
    """What one wish has found."""

    __slots__ = ("all", "data", "node", "references")

    def __init__(self, node: Any, references: list[ua.ReferenceDescription], data: bytes) -> None:
        self.node = node
        self.all = list(node.references)
        self.references, self.data = references, data


class BrowsePlan:
    """Browses for all sessions of one server."""

    def __init__(self, context: EndpointContext, views: ViewServices) -> None:
        self._context, self._limits, self._views = context, context.limits, views
        self._aspace: Any = context.iserver.aspace
        self._operations = OperationReader(ua.BrowseDescription, context.limits, _HEAD, around=_VIEW_MEMORY)
        self._results: dict[bytes, _Result] = {}
        self._bytes = 0
        self._types: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        self._state = (0, 0)
        """Nodes that are there, and how many have been removed."""

    async def serve(self, request: ServiceRequest, data: bytes, start: int) -> ArrayResponse | None:
        """The response; None for a request that is refused as a whole, which is left to those who know why.

        Args:
            request: whose it is.
            data: the whole request.
            start: where its parameters begin.

        Raises:
            Refusal: an operation is no valid encoding, or the request is not to go on.
        """
        begun = self._operations.begin(data, start)
        if begun is None or begun[1][0] != _NO_VIEW:
            return None
        scan, (_, _, _, wish, count) = begun
        limits = self._limits
        portion = min(limits.references_per_node, wish or limits.references_per_node)
        portions = BrowsePortions(request.session, ua.BrowseResponse, self._context)
        for _ in range(count):
            self._one(scan, portions, portion)
            await request.turns.end(portions.answer.size)
        return portions.answer

    def _one(self, scan: Scan, portions: BrowsePortions, portion: int) -> None:
        """Do one operation."""
        data, position = scan.data, scan.position
        scan.share = scan.memory
        step = self._operations.step
        scan.charge_built(step.memory)
        step.walk(scan)
        key = data[position : scan.position]
        known = self._known().get(key)
        if known is not None and known.all == known.node.references:
            if len(known.references) <= portion and portions.add_whole(known.data):
                return
            wish = int.from_bytes(key[-4:], "little")
            _add(portions, known.references, portion, wish)
            return
        scan.position = position
        wanted = self._operations.whole(scan)
        try:
            references = self._views.references(wanted, self._types)
        except Refusal as error:
            portions.refuse(error.ua_status)
            return
        mask = int(wanted.ResultMask)
        whole = portions.whole(references, mask) if len(references) <= min(portion, _MOST_REFERENCES) else None
        if whole is not None:
            self._keep(key, _Result(self._aspace.get(wanted.NodeId), references, whole))
            if portions.add_whole(whole):
                return
        _add(portions, references, portion, mask)

    def _known(self) -> dict[bytes, _Result]:
        nodes = self._aspace._nodes  # noqa: SLF001 - it has no accessor
        state = len(nodes), nodes.removed
        if state != self._state:
            self._results.clear()
            self._types.clear()
            self._bytes, self._state = 0, state
        return self._results

    def _keep(self, key: bytes, result: _Result) -> None:
        if self._bytes > _MOST_BYTES or len(self._results) >= _MOST_RESULTS:
            self._results.clear()
            self._bytes = 0
        self._bytes += len(key) + len(result.data)
        self._results[key] = result


def _add(portions: BrowsePortions, references: list[ua.ReferenceDescription], portion: int, mask: int) -> None:
    try:
        portions.add(references, portion, mask)
    except Refusal as error:
        portions.refuse(error.ua_status)
