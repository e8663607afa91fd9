"""How a launcher starts another Python interpreter.

The ROS 2 wheels start every Python of their environment a second time, with LD_LIBRARY_PATH naming their libraries and
a mark that says that this was done. Children inherit both, and a child in another environment then loads the parent's
libraries. So whoever starts a process hands it `child_environment(os.environ)`; a child in our own environment sets
both again by itself.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

__all__ = ["ROS1_PYTHON_VARIABLE", "child_environment", "find_ros1_python"]

ROS1_PYTHON_VARIABLE: Final = "UA_FLEET_ROS1_PYTHON"
"""Names the interpreter that has rospy, where it is not the one of `.venv-ros1`."""

_BOOTSTRAP_MARK: Final = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_LIBRARY_PATH: Final = "LD_LIBRARY_PATH"
_WHEEL_LIBRARIES = re.compile(r"(?P<prefix>.*)/lib/python3\.\d+/site-packages/ros_[^/]*\.libs")


def child_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """`environment` without what the ROS 2 wheels left in it; what the user had put there stays."""
    cleaned = {name: value for name, value in environment.items() if name != _BOOTSTRAP_MARK}
    if _BOOTSTRAP_MARK not in environment or _LIBRARY_PATH not in environment:
        return cleaned
    folders = [folder for folder in environment[_LIBRARY_PATH].split(os.pathsep) if folder]
    matches = [match for folder in folders if (match := _WHEEL_LIBRARIES.fullmatch(folder))]
    leaked = {match[0] for match in matches} | {f"{match['prefix']}/lib" for match in matches}
    kept = [folder for folder in folders if folder not in leaked]
    if kept:
        cleaned[_LIBRARY_PATH] = os.pathsep.join(kept)
    else:
        del cleaned[_LIBRARY_PATH]
    return cleaned


def find_ros1_python(environment: Mapping[str, str], *, prefix: str = sys.prefix) -> Path | None:
    """The interpreter for ROS 1 bridges, or None when there is none.

    Args:
        environment: where UA_FLEET_ROS1_PYTHON may name it.
        prefix: the running virtual environment; `.venv-ros1` is looked for beside it, then in the working directory.
    """
    named = environment.get(ROS1_PYTHON_VARIABLE)
    if named:
        return Path(named) if os.access(named, os.X_OK) else None
    for folder in (Path(prefix).parent, Path.cwd()):
        python = folder / ".venv-ros1" / "bin" / "python"
        if os.access(python, os.X_OK):
            return python
    return None
