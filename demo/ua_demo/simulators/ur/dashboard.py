"""The dashboard server, port 29999: a line in, a line out. Pure.

Commands and answers are those of the e-Series dashboard server for PolyScope 5. What asks for something is refused
while the robot is in local control, what only asks is answered.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ua_bridges.ur.modes import RuntimeState, SafetyMode

from ua_demo.simulators.ur.controller import Controller, Refused

__all__ = ["GREETING", "Dashboard"]

GREETING: Final = "Connected: Universal Robots Dashboard Server"
LONGEST_LINE: Final = 4096


class Dashboard:
    """One connection."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.is_over = False
        self._rest = b""
        self._asking: dict[str, Callable[[str], str]] = {
            "running": lambda _: f"Program running: {str(controller.is_playing).lower()}",
            "robotmode": lambda _: f"Robotmode: {controller.robot_mode.name}",
            "safetymode": lambda _: f"Safetymode: {controller.safety_mode.name}",
            "safetystatus": lambda _: f"Safetystatus: {controller.safety_mode.name}",
            "programState": lambda _: f"{self._program_state()} {controller.program_name}".strip(),
            "isProgramSaved": lambda _: f"true {controller.loaded or ''}".strip(),
            "get loaded program": lambda _: self._loaded(),
            "is in remote control": lambda _: str(controller.remote_control).lower(),
            "get operational mode": lambda _: "NONE",
            "PolyscopeVersion": lambda _: self._version(),
            "version": lambda _: ".".join(str(part) for part in controller.settings.version),
            "get serial number": lambda _: controller.settings.serial,
            "get robot model": lambda _: controller.settings.model.name.upper().rstrip("E"),
            "addToLog": self._add_to_log,
            "quit": self._quit,
        }
        self._doing: dict[str, Callable[[str], str]] = {
            "load installation": lambda name: f"File not found: {name}",
            "load": self._load,
            "play": lambda _: self._do(controller.play, "Starting program", "Failed to execute: play"),
            "pause": lambda _: self._do(controller.pause_program, "Pausing program", "Failed to execute: pause"),
            "stop": lambda _: self._stop(),
            "popup": self._popup,
            "close popup": lambda _: self._close_popup(),
            "close safety popup": lambda _: self._close_safety_popup(),
            "power on": lambda _: self._do(controller.power_on, "Powering on"),
            "power off": lambda _: self._do(controller.power_off, "Powering off"),
            "brake release": lambda _: self._do(controller.release_brakes, "Brake releasing"),
            "unlock protective stop": lambda _: self._do(
                controller.unlock_protective_stop, "Protective stop releasing"
            ),
            "restart safety": lambda _: self._restart_safety(),
            "setUserRole": lambda role: f"Setting user role: {role}",
        }

    def receive(self, data: bytes) -> bytes:
        """Bytes in, the answers out.

        Raises:
            ValueError: a line without end.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            raise ValueError(f"a line of more than {LONGEST_LINE} bytes")
        return b"".join(self.answer(line.decode("utf-8", "replace").strip()).encode() + b"\n" for line in lines)

    def answer(self, line: str) -> str:
        """The answer to one command."""
        for commands in (self._asking, self._doing):
            for command, answer in commands.items():
                if line.lower() == command.lower() or line.lower().startswith(command.lower() + " "):
                    if commands is self._doing and not self._controller.remote_control:
                        return f"Failed to execute: {line} (the robot is in local control)"
                    return answer(line[len(command) :].strip())
        return f'could not understand: "{line}"'

    def _do(self, action: Callable[[], None], done: str, failed: str = "") -> str:
        try:
            action()
        except Refused as refusal:
            return failed or str(refusal)
        return done

    def _program_state(self) -> str:
        state = self._controller.runtime
        return state.name if state in (RuntimeState.PLAYING, RuntimeState.PAUSED) else "STOPPED"

    def _loaded(self) -> str:
        loaded = self._controller.loaded
        return f"Loaded program: /programs/{loaded}" if loaded else "No program loaded"

    def _version(self) -> str:
        major, minor, bugfix, build = self._controller.settings.version
        return f"URSoftware {major}.{minor}.{bugfix}.{build} (Jan 01 2024)"

    def _load(self, name: str) -> str:
        return self._do(lambda: self._controller.load(name), f"Loading program: {name}", f"File not found: {name}")

    def _stop(self) -> str:
        if self._controller.runtime is RuntimeState.STOPPED:
            return "Failed to execute: stop"
        self._controller.stop_program("the dashboard server was asked to")
        return "Stopped"

    def _popup(self, text: str) -> str:
        self._controller.popup = text
        return "showing popup"

    def _close_popup(self) -> str:
        self._controller.popup = None
        return "closing popup"

    def _close_safety_popup(self) -> str:
        self._controller.safety_popup = None
        return "closing safety popup"

    def _restart_safety(self) -> str:
        if self._controller.safety_mode not in (SafetyMode.FAULT, SafetyMode.VIOLATION):
            return "Failed to execute: restart safety"
        self._controller.reset_safety()
        return "Restarting safety"

    def _add_to_log(self, text: str) -> str:
        if not text:
            return "No log message to add"
        self._controller.say("info", text)
        return "Added log message"

    def _quit(self, _: str) -> str:
        self.is_over = True
        return "Disconnected"
