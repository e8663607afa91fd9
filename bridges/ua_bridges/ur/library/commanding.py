"""The child that commands the robot: `python -m ua_bridges.ur.library.commanding HOST`.

    {"on": "dashboard", "call": "powerOn", "args": []}      a method of ur-rtde's DashboardClient
    {"on": "io", "call": "setSpeedSlider", "args": [0.5]}   of its RTDEIOInterface
    {"on": "control", "call": "moveJ", "args": [..]}        of its RTDEControlInterface, which is opened before:
    {"on": "control", "call": "open", "args": [false]}      true: use the control program that runs, and send none
    {"on": "control", "call": "operation", "args": []}      whether an asynchronous move runs, and its number

The answer to each line is `{"result": ..}` or `{"error": "..", "refused": true}`; `refused` where it is sure that the
controller has begun nothing. Connections are made when they are needed, and anew after an error.
"""

from __future__ import annotations

import importlib
import json
import re
import resource
import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, Final

from ua_bridges.ur.library.lines import bound_memory, end_with_parent, open_output

_DASHBOARD_TIMEOUT_MS: Final = 2000
_REFUSALS: Final = re.compile(
    r"(unlock protective stop failure: )?(failed|could not|cannot|file not found|error|invalid|unable)", re.IGNORECASE
)
"""What refusals of the dashboard server begin with: the library raises the same for these and for a lost connection.

Before the refusal of an unlock it puts words of its own.
"""
_DESCRIPTORS: Final = resource.getrlimit(resource.RLIMIT_NOFILE)


class _Refused(Exception):
    """The controller has begun nothing."""


@contextmanager
def _connecting() -> Generator[None]:
    """Connections can be made in here alone.

    Where a connection breaks, ur-rtde makes a new one by itself, and stops the program that runs: a move would end with
    each fault of the network. Without a free file descriptor it cannot; it ends this process, and the bridge asks the
    controller what became of the move.
    """
    resource.setrlimit(resource.RLIMIT_NOFILE, _DESCRIPTORS)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, _DESCRIPTORS[1]))


def _library(module: str) -> Any:
    """A module of ur-rtde, which has no types."""
    return importlib.import_module(module)


class _Interfaces:
    def __init__(self, host: str) -> None:
        self._host = host
        self._open: dict[str, Any] = {}

    def do(self, on: str, call: str, arguments: list[Any]) -> Any:
        try:
            with _connecting():
                if (on, call) == ("control", "open"):
                    return self._open_control(uses_running=bool(arguments[0]))
                interface = self._of(on)
        except (RuntimeError, ImportError) as error:
            raise _Refused(_text_of(error)) from error
        try:
            if (on, call) == ("control", "operation"):
                status = interface.getAsyncOperationProgressEx()
                return [bool(status.isAsyncOperationRunning()), int(status.operationId())]
            return getattr(interface, call)(*arguments)
        except RuntimeError as error:
            if on == "io":  # a dashboard client raises for a refusal too, and control is opened with intent
                del self._open[on]
            if on == "dashboard" and _REFUSALS.match(_text_of(error)):
                raise _Refused(_text_of(error)) from error
            raise
        except (ValueError, TypeError, IndexError, AttributeError) as error:  # the library looks before it sends
            raise _Refused(_text_of(error)) from error

    def _of(self, on: str) -> Any:
        interface = self._open.get(on)
        if interface is None and on == "io":
            interface = _library("rtde_io").RTDEIOInterface(self._host)
        elif on == "dashboard" and (interface is None or not interface.isConnected()):
            interface = _library("dashboard_client").DashboardClient(self._host)
            interface.connect(_DASHBOARD_TIMEOUT_MS)
        if interface is None:
            raise RuntimeError(f"{on} is not open")
        self._open[on] = interface
        return interface

    def _open_control(self, *, uses_running: bool) -> bool:
        before = self._open.pop("control", None)
        if before is not None:
            before.disconnect()  # its registers are its own until then
        Control = _library("rtde_control").RTDEControlInterface  # noqa: N806 - it is a class
        flags = Control.FLAG_CUSTOM_SCRIPT if uses_running else Control.FLAG_UPLOAD_SCRIPT
        self._open["control"] = Control(self._host, -1.0, flags)
        return True


def _text_of(error: Exception) -> str:
    return str(error).strip() or type(error).__name__


def main(arguments: list[str]) -> int:
    """Serve until the bridge ends; the exit code."""
    output = open_output()
    end_with_parent()
    bound_memory()
    interfaces = _Interfaces(arguments[0])
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            answer = {"result": interfaces.do(asked["on"], asked["call"], asked["args"])}
        except _Refused as error:
            answer = {"error": str(error), "refused": True}
        except (RuntimeError, KeyError) as error:
            answer = {"error": _text_of(error), "refused": False}
        output.say(answer)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
