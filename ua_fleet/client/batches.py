# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Browse and Read of many nodes in few requests, each within the server's OperationLimits (OPC 10000-5 6.3.11)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final, TypeVar

from asyncua import Client, ua
from asyncua.ua.uaerrors import BadNoContinuationPoints

__all__ = ["Batches"]

Item = TypeVar("Item")

_BROWSE_AT_ONCE: Final = 500
"""Nodes in a Browse. With 100 references each the answer has some 5 MB; other clients have their turn in between."""
_READ_AT_ONCE: Final = 2_000
_TOO_LARGE: Final = frozenset({ua.StatusCodes.BadEncodingLimitsExceeded, ua.StatusCodes.BadResponseTooLarge})
"""What a server says of a result for which its answer has no room left."""
_FULL: Final = ua.StatusCodes.BadNoContinuationPoints
_LIMITS: Final = (
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerBrowse,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxMonitoredItemsPerCall,
)


def _parts(items: Sequence[Item], size: int) -> Iterator[Sequence[Item]]:
    for at in range(0, len(items), size):
        yield items[at : at + size]


class Batches:
    """What a connection asks of many nodes. Methods raise asyncua's errors."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._sizes: tuple[int, int, int] | None = None

    async def _size(self, which: int) -> int:
        """The largest request of a service: 0 Browse, 1 Read, 2 CreateMonitoredItems."""
        if self._sizes is None:
            ids = [ua.NodeId(ua.Int32(number)) for number in _LIMITS]
            told = await self._client.uaclient.read_attributes(ids, ua.AttributeIds.Value)
            limits = [data.Value.Value if data.Value is not None else None for data in told]
            # 0 and nothing are: the server has no limit, or does not say it.
            browse, read, items = (
                min(limit, most) if isinstance(limit, int) and limit > 0 else most
                for limit, most in zip(limits, (_BROWSE_AT_ONCE, _READ_AT_ONCE, _READ_AT_ONCE), strict=True)
            )
            self._sizes = browse, read, items
        return self._sizes[which]

    async def monitored_items_at_once(self) -> int:
        """The largest CreateMonitoredItems."""
        return await self._size(2)

    async def browse(
        self,
        node_ids: Sequence[ua.NodeId],
        *,
        references: int = ua.ObjectIds.HierarchicalReferences,
        classes: int = 0,
    ) -> list[list[ua.ReferenceDescription]]:
        """The forward references of nodes, in their order; none of a node that there is not.

        Args:
            node_ids: the nodes.
            references: the type of references; its subtypes are followed too.
            classes: mask of NodeClasses that are wanted; 0 is all.
        """
        found: list[list[ua.ReferenceDescription]] = []
        for part in _parts(node_ids, await self._size(0)):
            found += await self._browse(part, references, classes)
        return found

    async def _browse(
        self, node_ids: Sequence[ua.NodeId], references: int, classes: int
    ) -> list[list[ua.ReferenceDescription]]:
        found: list[list[ua.ReferenceDescription]] = [[] for _ in node_ids]
        left = list(range(len(node_ids)))
        while left:
            parameters = ua.BrowseParameters()
            parameters.NodesToBrowse = [_description(node_ids[place], references, classes) for place in left]
            results: Sequence[Any] = await self._client.uaclient.browse(parameters)
            refused = [place for place, one in zip(left, results, strict=True) if one.StatusCode.value == _FULL]
            waiting: list[tuple[int, bytes]] = []
            for place, result in zip(left, results, strict=True):
                found[place] += result.References or ()
                if result.ContinuationPoint:
                    waiting.append((place, result.ContinuationPoint))
            await self._follow(waiting, found)
            if len(refused) == len(left):
                raise BadNoContinuationPoints
            left = refused  # these had no continuation point left; those before them have given theirs back
        return found

    async def _follow(self, waiting: list[tuple[int, bytes]], found: list[list[ua.ReferenceDescription]]) -> None:
        while waiting:
            parameters = ua.BrowseNextParameters()
            parameters.ContinuationPoints = [point for _, point in waiting]
            parameters.ReleaseContinuationPoints = False
            results: Sequence[Any] = await self._client.uaclient.browse_next(parameters)
            more: list[tuple[int, bytes]] = []
            for (place, _), result in zip(waiting, results, strict=True):
                found[place] += result.References or ()
                if result.ContinuationPoint:
                    more.append((place, result.ContinuationPoint))
            waiting = more

    async def read(
        self, node_ids: Sequence[ua.NodeId], attribute: ua.AttributeIds = ua.AttributeIds.Value
    ) -> list[ua.DataValue]:
        """An attribute of nodes, in their order; Bad ones stand for themselves."""
        found: list[ua.DataValue] = []
        for part in _parts(node_ids, await self._size(1)):
            found += await self._read(list(part), attribute)
        return found

    async def _read(self, node_ids: list[ua.NodeId], attribute: ua.AttributeIds) -> list[ua.DataValue]:
        values = await self._client.uaclient.read_attributes(node_ids, attribute)
        left = [place for place, data in enumerate(values) if data.StatusCode and data.StatusCode.value in _TOO_LARGE]
        # The answer was full: these are asked for again by themselves, as long as that brings any of them.
        while left and (len(left) < len(node_ids)):
            again = await self._client.uaclient.read_attributes([node_ids[place] for place in left], attribute)
            for place, data in zip(left, again, strict=True):
                values[place] = data
            before = len(left)
            left = [place for place in left if (code := values[place].StatusCode) and code.value in _TOO_LARGE]
            if len(left) == before:
                left = left[1:]  # the first of them is too large by itself
        return values


def _description(node_id: ua.NodeId, references: int, classes: int) -> ua.BrowseDescription:
    wanted = ua.BrowseDescription()
    wanted.NodeId = node_id
    wanted.BrowseDirection = ua.BrowseDirection.Forward
    wanted.ReferenceTypeId = ua.NodeId(ua.Int32(references))
    wanted.IncludeSubtypes = True
    wanted.NodeClassMask = ua.UInt32(classes)
    wanted.ResultMask = ua.UInt32(ua.BrowseResultMask.All)
    return wanted
