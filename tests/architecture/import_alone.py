"""Imports each named module in a process of its own, and says which cannot be. Third-party packages are shared.

import_alone.py MODULE ...        prints a line `MODULE: reason` for each that fails
"""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import traceback

SHARED = ("asyncua", "cryptography.x509", "pydantic", "rich.console", "structlog", "typer", "yaml")
"""Only our own modules are to be new in each process."""
NOT_HERE = frozenset({"rclpy", "rospy", "rosgraph", "roslib", "genpy", "genmsg"})
"""What belongs to another environment or to an extra."""


def reason_against(module: str) -> str | None:
    """Why the module cannot be imported; None when it can, or when its environment is another one."""
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        missing = (error.name or "").split(".", 1)[0]
        return None if missing in NOT_HERE else str(error)
    except Exception:  # noqa: BLE001 - whatever a module does when it is imported is what we want to know
        return traceback.format_exc().strip().splitlines()[-1]
    return None


def main(modules: list[str]) -> None:
    """Import each in a fork of this process, which has none of our modules."""
    for name in SHARED:
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(name)
    for module in modules:
        child = os.fork()
        if child == 0:
            reason = reason_against(module)
            if reason is not None:
                print(f"{module}: {reason}", flush=True)
            os._exit(0)
        os.waitpid(child, 0)


main(sys.argv[1:])
