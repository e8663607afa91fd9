# pyright: basic, reportMissingImports=false
"""Calls of a service whose response comes as a callback in the node's thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from ua_bridges.ros2.node import Ros2Node, guarded

__all__ = ["Calls"]

_MOST_UNANSWERED: Final = 256
"""Calls that may wait for a response; the oldest is given up then."""


class Calls:
    """A client of one service."""

    def __init__(self, node: Ros2Node, service_class: Any, name: str) -> None:
        """Make the client in the node's thread; `name` is the full one."""
        self.name = name
        self._client = node.node.create_client(service_class, name)
        self._unanswered: dict[Any, None] = {}

    @property
    def is_ready(self) -> bool:
        """Whether a server is there."""
        return bool(self._client.service_is_ready())

    def call(self, request: Any, answered: Callable[[Any], None]) -> None:
        """Send a request; `answered` gets the response, however late, or never."""
        future = self._client.call_async(request)
        self._unanswered[future] = None
        if len(self._unanswered) > _MOST_UNANSWERED:
            oldest = next(iter(self._unanswered))
            del self._unanswered[oldest]
            self._client.remove_pending_request(oldest)

        def done(finished: Any) -> None:
            self._unanswered.pop(finished, None)
            if finished.exception() is None and finished.result() is not None:
                answered(finished.result())

        future.add_done_callback(guarded(done))
