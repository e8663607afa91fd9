# pyright: basic, reportMissingImports=false
"""Spinning nodes of rclpy until a signal ends them.

At SIGTERM rclpy wakes its executors first, and shuts the context down after that. `spin` that is awake between the two
finds a context that is good, waits again without an end, and nobody wakes it: the program does not end. Here it looks
at the context again and again. (rclpy's signal_handler.cpp; 2 of 42 programs at SIGTERM on a busy machine.)
"""

from __future__ import annotations

import contextlib
from typing import Any, Final

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

__all__ = ["spin", "spin_node"]

_LOOK_S: Final = 0.5


def spin(executor: Any) -> None:
    """Spin until rclpy's context is shut down, or Ctrl-C."""
    with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
        while rclpy.ok():  # pyright: ignore[reportPrivateImportUsage]
            executor.spin_once(timeout_sec=_LOOK_S)


def spin_node(node: Any) -> None:
    """Spin a node, one callback after the other."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spin(executor)
