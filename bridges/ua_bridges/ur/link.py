"""The way to a controller for commands: ur-rtde in its child, and a socket for URScript. For one thread."""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from typing import Any, Final

from ua_bridges.ur.library.child import ChildFailed, LibraryChild, NoAnswer
from ua_fleet.errors import RobotOffline, SkillError, SkillFailed, SkillTimeout

__all__ = ["CommandLink"]

_SCRIPT_PORT: Final = 30002
_OPEN_S: Final = 12.0
"""Python starts, and ur-rtde waits up to 5 s for its program."""
_STOP_S: Final = 10.0
_TAKEN_S: Final = 0.1
"""So long the socket stays open after a program: what the controller sends is read, so that closing loses nothing."""
_READ_BYTES: Final = 65_536


class CommandLink:
    """See the module."""

    def __init__(self, host: str, timeout_s: float) -> None:
        self._host, self._timeout_s = host, timeout_s
        self._child: LibraryChild | None = None
        self._is_open = False
        """Whether the child's interface to ur-rtde's control program is."""
        self.has_control = False
        """Whether that program was taken into use over this child, and nothing was sent in its place."""

    def call(self, on: str, method: str, *arguments: Any, timeout_s: float | None = None) -> Any:
        """Call a method of one of the library's interfaces; see `library.commanding`.

        Raises:
            SkillFailed: the library or the controller refuses it, and nothing was done; the text says why.
            SkillTimeout: it was said, and nobody can tell whether the controller has it. The child may have ended.
            RobotOffline: it could not be said.
        """
        limit = self._timeout_s if timeout_s is None else timeout_s
        if self._child is not None and self._child.has_ended:
            self.close()
        try:
            if self._child is None:
                self._child = LibraryChild("commanding", self._host)
                limit += _OPEN_S
            self._child.say({"on": on, "call": method, "args": list(arguments)})
        except ChildFailed as error:
            self.close()
            raise RobotOffline(f"{method}: {error}") from error
        try:
            answer: dict[str, Any] = self._child.line(limit)
        except NoAnswer as error:
            self.close()
            raise SkillTimeout(f"{method}: the controller does not answer ({error})") from error
        except ChildFailed as error:  # a connection that breaks ends it, before or after the controller has heard
            self.close()
            raise SkillTimeout(f"{method}: {error} before it answered") from error
        if "error" in answer:
            said = " ".join(str(answer["error"]).split())
            raise SkillFailed(said) if answer["refused"] else SkillTimeout(f"{method}: {said}")
        return answer["result"]

    # ur-rtde's control program

    def take_control(self, *, is_playing: bool) -> None:
        """Have ur-rtde's control program run.

        Args:
            is_playing: whether a program runs, as far as was told; where none does, the controller is asked once more.

        Raises:
            SkillError: it does not run, or another program does.
        """
        is_playing = is_playing or self.has_begun_one()
        if not self._is_open:
            self.call("control", "open", is_playing, timeout_s=_OPEN_S)
            self._is_open = True
        elif not is_playing:
            self._send_control_program()
        if is_playing:  # somebody may have begun another one since
            self.check_own_program()
        self.has_control = True

    def has_begun_one(self) -> bool:
        """Whether a program was begun since the state was told, which a busy machine takes in late."""
        try:
            return bool(self.call("dashboard", "running"))
        except SkillFailed:  # a controller without a dashboard server
            return False

    def _send_control_program(self) -> None:
        if self.call("control", "isProgramRunning"):  # begun since the state was told: ours would take its place
            self.check_own_program()
            return
        self.call("control", "reuploadScript", timeout_s=_OPEN_S)
        deadline = time.monotonic() + self._timeout_s
        while not self.call("control", "isProgramRunning"):
            if time.monotonic() > deadline:
                raise SkillFailed("the control program does not run; see the robot's log")
            time.sleep(0.01)

    def check_own_program(self) -> None:
        """The program that runs is ur-rtde's where it answers: we sent it, or a bridge before us has left it.

        Raises:
            SkillFailed: another one runs.
        """
        try:
            offset = self.call("control", "getTCPOffset")
        except (SkillFailed, SkillTimeout):
            offset = None
        if not offset or len(offset) != 6:
            self.close()
            raise SkillFailed("another program runs on the controller; stop it first")

    def operation(self) -> tuple[bool, int]:
        """Whether an asynchronous move runs, and the number of the last.

        Raises:
            SkillError: as `call`.
        """
        is_running, number = self.call("control", "operation")
        return bool(is_running), int(number)

    def stop_move(self, deceleration: float) -> bool:
        """Slow down a move of the control program; False where it makes none, or cannot be told."""
        if not self.has_control:
            return False
        try:
            is_moving, _ = self.operation()
            if is_moving:
                self.call("control", "stopJ", deceleration, timeout_s=_STOP_S)
            return is_moving and not self.operation()[0]  # a paused program does not hear it, and nothing says so
        except SkillError:
            return False

    def stop_control(self) -> None:
        """End the control program.

        Raises:
            SkillError: as `call`.
        """
        self.call("control", "stopScript")
        self.has_control = False

    # Any program

    def stop_program(self) -> None:
        """Have the dashboard server stop what runs.

        Raises:
            SkillError: as `call`.
        """
        self.call("dashboard", "stop")
        self.has_control = False

    # URScript

    def send_script(self, program: str) -> None:
        """Send a program to port 30002.

        Raises:
            RobotOffline: the controller does not take the connection.
            SkillTimeout: it broke; nobody can tell how much of the program has arrived.
        """
        try:
            connection = socket.create_connection((self._host, _SCRIPT_PORT), self._timeout_s)
        except OSError as error:
            reason = f"port {_SCRIPT_PORT}: {error.strerror or error}; see that the controller lets the bridge in there"
            raise RobotOffline(reason) from error
        self.has_control = False
        with connection:
            try:
                connection.sendall(program.encode())
            except OSError as error:
                raise SkillTimeout(f"port {_SCRIPT_PORT}: {error.strerror or error}") from error
            with suppress(OSError):  # it was sent: what the controller shows has to tell
                _read_for(_TAKEN_S, connection)

    def close(self) -> None:
        """End the child; what a move does on the controller goes on."""
        child, self._child = self._child, None
        self._is_open = self.has_control = False
        if child is not None:
            child.end()


def _read_for(seconds: float, connection: socket.socket) -> None:
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0:
        connection.settimeout(left)
        if not connection.recv(_READ_BYTES):
            return
