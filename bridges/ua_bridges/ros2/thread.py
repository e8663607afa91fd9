# pyright: basic, reportMissingImports=false
"""The one thread in which a ROS 2 node lives: it makes the node, spins it, looks after it, and ends it."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, Literal

import structlog

from ua_bridges.ros2.node import Ros2Node, guarded
from ua_fleet.errors import DriverFailed, UaFleetError

__all__ = ["NodeThread"]

_LONGEST_SPIN_S: Final = 1.0
_SHORTEST_SPIN_S: Final = 0.0005
_MOST_IN_A_ROW: Final = 1_000
"""Events of destroyed entities, with nothing else between them, that are no mistake of the bridge."""

_log = structlog.get_logger(__name__)


class NodeThread:
    """Runs a node until it is stopped. `call` hands it work from any other thread."""

    def __init__(
        self,
        domain: int,
        node_name: str,
        discovery: Literal["localhost", "subnet"],
        beside: NodeThread | None = None,
    ) -> None:
        """Prepare a thread; `beside` has the node whose participant this one shares, and is stopped after it."""
        self._domain, self._node_name, self._beside = domain, node_name, beside
        self._discovery: Literal["localhost", "subnet"] = discovery
        self._thread: threading.Thread | None = None
        self._node: Ros2Node | None = None
        self._jobs: deque[Callable[[], None]] = deque()
        self._due = 0.0
        self._stopping = False
        self._waking = threading.Lock()
        """Keeps the node from ending while another thread wakes it."""
        self.failure: str | None = None
        """Why the node is gone without having been stopped."""

    @property
    def running(self) -> bool:
        """Whether the node is in its domain."""
        return self._node is not None and not self._stopping and self.failure is None

    @property
    def node(self) -> Ros2Node | None:
        """The node while it is there."""
        return self._node

    async def start(
        self, opened: Callable[[Ros2Node], None], turn: Callable[[float], float], closing: Callable[[], None]
    ) -> None:
        """Make the node; returns when it is there.

        Args:
            opened: called once with the node; what it raises is raised here.
            turn: called with the monotonic time when the time that it returned last has come.
            closing: called before the node ends.

        All three are called in the node's thread.

        Raises:
            BridgeUnavailable, TopicInvalid: see `make_node`.
            DriverFailed: a mistake of the bridge.
        """
        loop = asyncio.get_running_loop()
        ready: asyncio.Future[None] = loop.create_future()

        def tell(error: Exception | None) -> None:
            if ready.done():
                return
            if error is None:
                ready.set_result(None)
            elif isinstance(error, UaFleetError):
                ready.set_exception(error)
            else:
                _log.error("the ROS 2 node did not start", domain=self._domain, exc_info=error)
                ready.set_exception(DriverFailed(f"no ROS 2 node in domain {self._domain}: {_mistake(error)}"))

        def run() -> None:
            try:
                beside = self._beside.node if self._beside is not None else None
                node = Ros2Node(self._domain, self._node_name, self._discovery, beside)
            except Exception as error:  # noqa: BLE001 - whatever it is, the start waits for it
                loop.call_soon_threadsafe(tell, error)
                return
            try:
                opened(node)
                self._node = node
                loop.call_soon_threadsafe(tell, None)
                self._spin(node, turn)
            except Exception as error:  # noqa: BLE001 - as above
                loop.call_soon_threadsafe(tell, error)
            finally:
                with self._waking:
                    self._node = None
                try:
                    closing()
                finally:
                    node.close()

        self._thread = threading.Thread(target=run, name=f"ros2 domain {self._domain}", daemon=True)
        self._thread.start()
        await ready

    def _spin(self, node: Ros2Node, turn: Callable[[float], float]) -> None:
        spin_once, jobs = node.executor.spin_once, self._jobs
        in_a_row = 0
        try:
            while not self._stopping:
                while jobs:
                    guarded(jobs.popleft())()
                now = time.monotonic()
                if now >= self._due:
                    self._due = turn(now)
                try:
                    spin_once(timeout_sec=min(max(self._due - now, _SHORTEST_SPIN_S), _LONGEST_SPIN_S))
                    in_a_row = 0
                except node.destroyed:
                    # An event of a subscription that was destroyed while it waited for its turn: it concerns nobody.
                    in_a_row += 1
                    if in_a_row >= _MOST_IN_A_ROW:
                        raise
        except Exception as error:  # noqa: BLE001 - nobody else would hear of it: `status` tells
            _log.exception("the ROS 2 node ended", domain=self._domain)
            self.failure = f"the ROS 2 node ended: {_mistake(error)}"

    def call(self, job: Callable[[], None]) -> None:
        """Have `job` done soon in the node's thread; forgotten when the node ends before its turn."""
        self._jobs.append(job)
        self._wake()

    def _wake(self) -> None:
        with self._waking:
            if self._node is not None:
                self._node.executor.create_task(_nothing)  # ends a spin_once that waits

    def wake_at(self, due: float) -> None:
        """Have the turn come no later than `due`; for the node's own thread."""
        self._due = min(self._due, due)

    async def stop(self) -> None:
        """End the node and its thread."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._stopping = True
        self._wake()
        await asyncio.to_thread(thread.join)


def _mistake(error: Exception) -> str:
    return f"a mistake of the bridge ({error!r}); report its log, and start it again"


def _nothing() -> None:
    """Wakes the executor."""
