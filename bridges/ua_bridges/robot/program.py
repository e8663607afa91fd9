"""Requests in, status out, both as JSON texts; the functions of a robot's program run in threads between them."""

from __future__ import annotations

import contextlib
import inspect
import json
import logging
import math
import threading
from collections.abc import Callable, Mapping
from typing import Any, Final, cast

__all__ = ["Announcer", "Busy", "Canceled", "Execution", "Program", "Refused"]

_MOST_REMEMBERED: Final = 1000
"""Ended executions; the oldest are forgotten, and a query for them is answered with `unknown`."""
_LOOK_S: Final = 0.05
"""How often a function that stands looks whether it may go on."""
_ENDS: Final = ("refused", "done", "failed", "halted")

_log = logging.getLogger(__name__)


class Refused(Exception):
    """Raised by a function before it does anything: it will not."""


class Busy(Refused):
    """The same, because the robot is at something else: it may be asked again."""


class Canceled(Exception):
    """Raised by `Execution.check` when somebody wants it to stop; a function may also raise it itself."""


class Execution:
    """What a function is told beside its arguments."""

    def __init__(self, execution_id: str, timeout_s: float, report: Callable[[float, str], None]) -> None:
        self.id = execution_id
        """32 hexadecimal digits, unique for ever."""
        self.timeout_s = timeout_s
        """After so long it is given up."""
        self.canceled = threading.Event()
        """Set when it has to stop; `wait` on it in place of sleeping."""
        self.suspended = threading.Event()
        """Set while it has to stand: bring the robot to rest, then call `wait_if_suspended`."""
        self.stands = False
        """Whether a thread of it waits there."""
        self._report = report
        self._said = 0.0, ""

    def progress(self, fraction: float, message: str = "") -> None:
        """Tell how far it is, 0 to 1; raises Canceled as `check` does."""
        self.check()
        self._said = min(max(float(fraction), 0.0), 1.0), message
        self._report(*self._said)

    def check(self) -> None:
        """Raise Canceled if it has to stop."""
        if self.canceled.is_set():
            raise Canceled

    def wait_if_suspended(self) -> bool:
        """Wait here while it has to stand, and say that it does; whether it had to. Raises Canceled as `check` does.

        Call it where the robot is at rest, and could go on from: nothing is stopped by it.
        """
        self.check()
        if not self.suspended.is_set():
            return False
        self.stands = True
        self._report(*self._said)
        while self.suspended.is_set() and not self.canceled.wait(_LOOK_S):
            pass
        self.stands = False
        self.check()
        self._report(*self._said)
        return True


Function = Callable[..., Mapping[str, Any] | None]


class Program:
    """One skill. `say` publishes a status; it is called from any thread."""

    def __init__(self, name: str, function: Function, say: Callable[[str], None], *, at_once: int = 1) -> None:
        """Offer a skill.

        Args:
            name: the skill's name in `fleet.yaml`.
            function: gets an Execution and the arguments by their names.
            say: publishes a text.
            at_once: executions that may be under way.
        """
        self.name = name
        self._function, self._signature = function, inspect.signature(function)
        self._publish, self._at_once = say, at_once
        self._lock = threading.Lock()
        self._known: dict[str, dict[str, Any]] = {}
        """The last status of each execution."""
        self._open: dict[str, Execution] = {}

    def receive(self, text: str) -> None:
        """Take a request; what is none is logged and left alone."""
        try:
            request: Any = json.loads(text)
            what, execution_id = request.get("request", "execute"), request["execution_id"]
            if len(bytes.fromhex(execution_id)) != 16:
                raise ValueError("execution_id has to have 32 hexadecimal digits")
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            _log.warning("%s: not a request: %s", self.name, error)
            return
        if what == "execute":
            self._execute(execution_id, request)
        elif what == "cancel" and execution_id in self._open:
            with contextlib.suppress(KeyError):
                self._open[execution_id].canceled.set()
        elif what in ("suspend", "resume") and execution_id in self._open:
            with contextlib.suppress(KeyError):  # the function says itself that it stands, or goes on
                suspended = self._open[execution_id].suspended
                (suspended.set if what == "suspend" else suspended.clear)()
        else:  # a query, or something newer than this program: the state is always a right answer
            self._say_again(execution_id)

    def _say_again(self, execution_id: str) -> None:
        status = self._known.get(execution_id)
        if status is None:
            said = "this program remembers nothing of it"
            status = {"execution_id": execution_id, "state": "unknown", "message": said}
        self._publish(json.dumps(status))

    def _execute(self, execution_id: str, request: Mapping[str, Any]) -> None:
        def report(fraction: float, message: str) -> None:
            state = "suspended" if execution.stands else "running"
            self._say(execution_id, state, 0.0 if math.isnan(fraction) else fraction, message)

        arguments: Any = request.get("arguments") or {}
        execution = Execution(execution_id, _seconds(request.get("timeout_s")), report)
        with self._lock:
            is_known = execution_id in self._known
            problem = None if is_known else self._problem(request.get("skill"), execution, arguments)
            is_busy = not is_known and problem is None and len(self._open) >= self._at_once
            if is_busy:
                problem = f"{self.name} is being done already"
            if not is_known:
                state = "accepted" if problem is None else "refused"
                status = {"execution_id": execution_id, "state": state, "message": problem or "", "busy": is_busy}
                self._remember(execution_id, status)
                if problem is None:
                    self._open[execution_id] = execution
        self._say_again(execution_id)
        if not is_known and problem is None:
            name = f"skill {self.name}"
            threading.Thread(target=self._run, args=(execution, arguments), name=name, daemon=True).start()

    def _problem(self, skill: object, execution: Execution, arguments: object) -> str | None:
        if skill not in (None, self.name):
            return f"this is {self.name}, and not {skill}"
        if not isinstance(arguments, dict):
            return "`arguments` is no object"
        try:
            self._signature.bind(execution, **cast("dict[str, Any]", arguments))
        except TypeError as error:
            return f"{self.name}: {error}"
        return None

    def _run(self, execution: Execution, arguments: dict[str, Any]) -> None:
        state, results, message, is_busy = "done", dict[str, Any](), "", False
        try:
            results = _results_of(self._function(execution, **arguments))
        except Refused as refused:
            state, message, is_busy = "refused", str(refused) or "refused", isinstance(refused, Busy)
        except Canceled:
            state, message = "halted", "it was halted"
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever the robot's programmer has not foreseen
            _log.exception("%s failed", self.name)
            state, message = "failed", f"{type(error).__name__}: {error}"
        with self._lock:
            del self._open[execution.id]  # before its end is said: who hears of that may ask for the next one at once
        self._say(execution.id, state, 1.0 if state == "done" else 0.0, message, results, is_busy=is_busy)

    def _say(
        self,
        execution_id: str,
        state: str,
        progress: float = 0.0,
        message: str = "",
        results: Mapping[str, Any] | None = None,
        *,
        is_busy: bool = False,
    ) -> None:
        status = {
            "execution_id": execution_id,
            "state": state,
            "progress": progress,
            "results": results or {},
            "message": message,
            "busy": is_busy,
        }
        with self._lock:
            if self._known.get(execution_id, {}).get("state") in _ENDS:
                return  # a thread of the function's own that goes on after it
            self._remember(execution_id, status)
        self._publish(json.dumps(status))

    def _remember(self, execution_id: str, status: dict[str, Any]) -> None:
        self._known[execution_id] = status
        if len(self._known) > _MOST_REMEMBERED + len(self._open):
            del self._known[next(known for known in self._known if known not in self._open)]


class Announcer:
    """What a robot says of its own fault: one line, which is empty while it has none. Callable from any thread.

    It is said once for each change, and kept for who listens later.
    """

    def __init__(self, publish: Callable[[str], None] | None) -> None:
        """`publish` says a text, and keeps it; None where the robot has no id to say it under."""
        self._publish = publish
        self._lock = threading.Lock()
        self._said: str | None = None

    def fault(self, reason: str) -> None:
        """The robot cannot work. The server gives its tasks to others, until `repaired`.

        A reason that begins with capacities of the robot, `mobile: the drive is hot`, takes these alone away: tasks
        that need none of them go on. What is said last is all that is wrong.

        Raises:
            ValueError: without a reason, or without `fault_id`.
        """
        reason = " ".join(reason.split())
        if not reason:
            raise ValueError("say in a line what is wrong")
        self._say(reason)

    def repaired(self) -> None:
        """The robot can work. Whoever may have announced a fault before a restart says this, too, once all is well."""
        self._say("")

    def _say(self, text: str) -> None:
        if self._publish is None:
            raise ValueError("this robot has no id to announce faults under; give Robot the fault_id of fleet.yaml")
        with self._lock:
            if text != self._said:
                self._said = text
                self._publish(text)


def _results_of(returned: object) -> dict[str, Any]:
    """What a function has returned, as it can be said. Raises TypeError or ValueError."""
    if returned is None:
        return {}
    if not isinstance(returned, Mapping):
        raise TypeError(f"a skill returns its results by their names, or nothing, and not {type(returned).__name__}")
    results = dict(cast("Mapping[str, Any]", returned))
    json.dumps(results, allow_nan=False)
    return results


def _seconds(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.inf
