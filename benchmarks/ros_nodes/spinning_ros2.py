# pyright: basic, reportMissingImports=false
"""How the rclpy nodes of the benchmarks work: in an EventsExecutor with a thread of its own."""

import contextlib
import threading
from collections.abc import Iterator

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node

__all__ = ["spinning"]


@contextlib.contextmanager
def spinning(node: Node) -> Iterator[None]:
    """Have a node hear while the context lasts; then it ends, and rclpy with it."""
    executor = EventsExecutor()
    executor.add_node(node)
    stopping = threading.Event()

    def spin() -> None:
        while not stopping.is_set():
            executor.spin_once(timeout_sec=0.2)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
