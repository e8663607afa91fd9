"""What only a simulator has: a JSON object a line, to do to the robot what people and the world do to it. Pure.

    {"do": "protective_stop", "reason": ".."}   {"do": "safeguard_stop"}   {"do": "emergency_stop"}   {"do": "fault"}
    {"do": "reset_safety"}                      release the emergency stop, close the gate
    {"do": "remote_control", "on": false}       the switch on the teach pendant
    {"do": "power_off"}   {"do": "start_up"}
    {"do": "digital_input", "bit": 0, "on": true}   {"do": "analog_input", "place": 0, "value": 2.5}
    {"do": "output_registers", "first": 12, "values": [1.5]}   what a program writes to output double registers
    {"do": "record", "input": "input_double_register_18"}      keep what clients write; {"do": "recorded", ..} tells it
    {"do": "drop"}                              all connections of all other ports end, as when the cable is pulled
    {"do": "silence", "on": true}               accept connections and answer nothing, as a controller that hangs;
                                                {.., "port": "dashboard"}: this one alone
    {"do": "state"}   {"do": "log"}

The answer is a JSON object with `done`, and what was asked for; or `error`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from ua_bridges.ur.modes import SafetyMode

from ua_demo.simulators.ur.controller import REGISTERS, Controller

__all__ = ["Provoking"]


class Provoking:
    """See the module."""

    def __init__(self, controller: Controller, drop: Callable[[], None], silence: Callable[[bool, str], None]) -> None:
        self._controller = controller
        self._deeds: dict[str, Callable[[dict[str, Any]], dict[str, Any] | None]] = {
            "protective_stop": lambda asked: self._stop(SafetyMode.PROTECTIVE_STOP, asked),
            "safeguard_stop": lambda asked: self._stop(SafetyMode.SAFEGUARD_STOP, asked),
            "emergency_stop": lambda asked: self._stop(SafetyMode.ROBOT_EMERGENCY_STOP, asked),
            "system_emergency_stop": lambda asked: self._stop(SafetyMode.SYSTEM_EMERGENCY_STOP, asked),
            "violation": lambda asked: self._stop(SafetyMode.VIOLATION, asked),
            "fault": lambda asked: self._stop(SafetyMode.FAULT, asked),
            "reset_safety": lambda _: controller.reset_safety(),
            "remote_control": self._remote_control,
            "power_off": lambda _: controller.power_off(),
            "start_up": lambda _: controller.start_up(),
            "digital_input": self._digital_input,
            "analog_input": self._analog_input,
            "output_registers": self._output_registers,
            "record": self._record,
            "recorded": lambda asked: {"recorded": self._controller.recorded[str(asked["input"])]},
            "drop": lambda _: drop(),
            "silence": lambda asked: silence(bool(asked.get("on", True)), str(asked.get("port", ""))),
            "state": lambda _: self._state(),
            "log": lambda _: {"log": [[line.kind, line.text, line.line] for line in controller.log]},
        }

    def answer(self, line: str) -> str:
        """The answer to one line."""
        try:
            asked = json.loads(line)
            deed = self._deeds[asked["do"]]
            found = deed(asked)
        except (ValueError, TypeError, KeyError) as error:
            return json.dumps({"error": f"{type(error).__name__}: {error}"})
        return json.dumps({"done": True, **(found or {})})

    def _stop(self, mode: SafetyMode, asked: dict[str, Any]) -> None:
        self._controller.stop_for_safety(mode, str(asked.get("reason", "provoked")))

    def _remote_control(self, asked: dict[str, Any]) -> None:
        self._controller.remote_control = bool(asked["on"])

    def _digital_input(self, asked: dict[str, Any]) -> None:
        bit = int(asked["bit"])
        if not 0 <= bit < 18:
            raise ValueError("inputs are 0 to 17")
        mask = 1 << bit
        inputs = self._controller.digital_inputs
        self._controller.digital_inputs = inputs | mask if asked["on"] else inputs & ~mask

    def _analog_input(self, asked: dict[str, Any]) -> None:
        self._controller.analog_inputs[int(asked["place"])] = float(asked["value"])

    def _output_registers(self, asked: dict[str, Any]) -> None:
        first, values = int(asked["first"]), [float(value) for value in asked["values"]]
        if not 0 <= first <= REGISTERS - len(values):
            raise ValueError(f"registers are 0 to {REGISTERS - 1}")
        self._controller.outputs.doubles[first : first + len(values)] = values

    def _record(self, asked: dict[str, Any]) -> None:
        self._controller.recorded.setdefault(str(asked["input"]), [])

    def _state(self) -> dict[str, Any]:
        controller = self._controller
        return {
            "time": controller.time,
            "robot_mode": controller.robot_mode.name,
            "safety_mode": controller.safety_mode.name,
            "runtime": controller.runtime.name,
            "program": controller.program_name,
            "remote_control": controller.remote_control,
            "q": controller.arm.q,
            "pose": controller.arm.tcp_pose(),
            "speed_slider": controller.speed_slider,
            "digital_outputs": controller.digital_outputs,
            "analog_outputs": controller.analog_outputs,
            "popup": controller.popup,
        }
