# pyright: reportPrivateImportUsage=false
"""How old values are that hold the monotonic clock of their publication."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any

from asyncua import ua

__all__ = ["Ages", "watch_node"]


class Ages:
    """Notes ages, and gives them away when a line comes on stdin."""

    def __init__(self) -> None:
        self._noted: list[float] = []

    def note(self, value: Any) -> None:
        if isinstance(value, float) and value > 0:
            self._noted.append(time.monotonic() - value)

    async def serve(self) -> None:
        """Answer each line, until stdin ends."""
        while await asyncio.to_thread(sys.stdin.readline):
            noted, self._noted = self._noted, []
            print(json.dumps([round(age * 1e6, 1) for age in noted]), flush=True)


def watch_node(server: Any, node_id: str, ages: Ages) -> None:
    """Note the age of each value that a node of this process's server gets."""

    async def changed(_handle: int, value: ua.DataValue) -> None:
        ages.note(value.Value.Value if value.Value is not None else None)

    status, _ = server.iserver.aspace.add_datachange_callback(
        ua.NodeId.from_string(node_id), ua.AttributeIds.Value, changed
    )
    status.check()
