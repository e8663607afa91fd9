"""Real-Time Data Exchange, protocol version 2: one session for each connection. Bytes in, bytes out.

    V version    v controller's version    M text message
    O output recipe   I input recipe   S start   P pause   U data, both ways

A package is a UInt16 with its whole size, one byte with its type, and its payload, in network byte order (RTDE guide).
A session that breaks the framing is over; one that asks for what is not there is told so, and goes on. Inputs are taken
before a start too: ur-rtde's client for inputs and outputs never sends one.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from ua_demo.simulators.ur.controller import PERIOD_S, Controller
from ua_demo.simulators.ur.variables import INPUTS, OUTPUTS, TYPES, packed

__all__ = ["ProtocolError", "RtdeInputs", "RtdeSession"]

VERSION: Final = 2
_HEADER: Final = struct.Struct(">HB")
_MOST_INPUT_RECIPES: Final = 255
_MANY: Final = 1_000_000
_WARNING: Final = 2
"""Level of a text message: 0 exception, 1 error, 2 warning, 3 info."""


class ProtocolError(Exception):
    """The client does not speak RTDE."""


class RtdeInputs:
    """Which session writes which input; one that another has is IN_USE."""

    def __init__(self) -> None:
        self._owners: dict[str, object] = {}

    def claim(self, name: str, owner: object) -> bool:
        """Whether it may write the input; from now on nobody else may."""
        return self._owners.setdefault(name, owner) is owner

    def release(self, owner: object) -> None:
        """The session is over."""
        self._owners = {name: held for name, held in self._owners.items() if held is not owner}


@dataclass(frozen=True)
class _OutputRecipe:
    every: int
    """Cycles between two packages."""
    layout: struct.Struct
    readers: tuple[tuple[bool, Callable[[Controller], Any]], ...]

    def pack(self, controller: Controller) -> bytes:
        values: list[Any] = []
        for is_scalar, read in self.readers:
            if is_scalar:
                values.append(read(controller))
            else:
                values.extend(read(controller))
        return self.layout.pack(*values)


@dataclass(frozen=True)
class _InputRecipe:
    names: tuple[str, ...]
    layout: struct.Struct

    def unpack(self, payload: bytes) -> dict[str, Any]:
        flat = iter(self.layout.unpack(payload))
        values: dict[str, Any] = {}
        for name in self.names:
            count = _count(INPUTS[name].type)
            values[name] = next(flat) if count == 1 else [next(flat) for _ in range(count)]
        return values


def _count(type_name: str) -> int:
    digits = TYPES[type_name][:-1]
    return int(digits) if digits else 1


@dataclass
class RtdeSession:
    """See the module."""

    controller: Controller
    inputs: RtdeInputs
    _rest: bytes = b""
    _negotiated: bool = False
    _output: _OutputRecipe | None = None
    _input_recipes: list[_InputRecipe] = field(default_factory=list[_InputRecipe])
    is_started: bool = False

    def receive(self, data: bytes) -> bytes:
        """Bytes in, the answers out.

        Raises:
            ProtocolError: these are no RTDE packages.
        """
        self._rest += data
        answers: list[bytes] = []
        while len(self._rest) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._rest)
            if size < _HEADER.size:
                raise ProtocolError(f"a package of {size} bytes")
            if len(self._rest) < size:
                break
            payload, self._rest = self._rest[_HEADER.size : size], self._rest[size:]
            answers.append(self._answer(chr(kind), payload))
        return b"".join(answers)

    def cycles_until_due(self, cycle: int) -> int:
        """Cycles after this one until data are due; many where none are."""
        recipe = self._output
        return recipe.every - cycle % recipe.every if recipe is not None and self.is_started else _MANY

    def due(self, cycle: int) -> bytes:
        """The data of this cycle; nothing where none is due."""
        recipe = self._output
        if recipe is None or not self.is_started or cycle % recipe.every:
            return b""
        return _package("U", b"\x01" + recipe.pack(self.controller))

    def close(self) -> None:
        """The connection is over."""
        self.inputs.release(self)

    def _answer(self, kind: str, payload: bytes) -> bytes:
        if kind == "V":
            return self._negotiate(payload)
        if kind == "v":
            return _package("v", struct.pack(">4I", *self.controller.settings.version))
        if not self._negotiated:
            return _text("negotiate the protocol version first; only version 2 is spoken")
        answers: dict[str, Callable[[bytes], bytes]] = {
            "O": self._set_up_output,
            "I": self._set_up_input,
            "S": self._start,
            "P": self._pause,
            "U": self._take,
            "M": lambda _: b"",
        }
        answer = answers.get(kind)
        return answer(payload) if answer is not None else _text(f"there is no package of type {kind!r}")

    def _negotiate(self, payload: bytes) -> bytes:
        self._negotiated = payload == struct.pack(">H", VERSION)
        return _package("V", bytes([self._negotiated]))

    def _set_up_output(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            return _package("O", b"\x00NOT_FOUND")
        (frequency,) = struct.unpack_from(">d", payload)
        fastest = round(1 / PERIOD_S)
        names = _names(payload[8:])
        types = [OUTPUTS[name].type if name in OUTPUTS else "NOT_FOUND" for name in names]
        if not names or "NOT_FOUND" in types or not 1.0 <= frequency <= fastest:
            self._output = None
            return _package("O", b"\x00" + ",".join(types).encode())
        readers = tuple((OUTPUTS[name].is_scalar, OUTPUTS[name].read) for name in names)
        self._output = _OutputRecipe(max(round(fastest / frequency), 1), packed(types), readers)
        return _package("O", b"\x01" + ",".join(types).encode())

    def _set_up_input(self, payload: bytes) -> bytes:
        names = _names(payload)
        types: list[str] = []
        for name in names:
            if name not in INPUTS:
                types.append("NOT_FOUND")
            else:
                types.append(INPUTS[name].type if self.inputs.claim(name, self) else "IN_USE")
        if not names or {"NOT_FOUND", "IN_USE"} & set(types) or len(self._input_recipes) >= _MOST_INPUT_RECIPES:
            return _package("I", b"\x00" + ",".join(types).encode())
        self._input_recipes.append(_InputRecipe(tuple(names), packed(types)))
        return _package("I", bytes([len(self._input_recipes)]) + ",".join(types).encode())

    def _start(self, payload: bytes) -> bytes:
        self.is_started = self._output is not None or bool(self._input_recipes)
        return _package("S", bytes([self.is_started]))

    def _pause(self, payload: bytes) -> bytes:
        self.is_started = False
        return _package("P", b"\x01")

    def _take(self, payload: bytes) -> bytes:
        number = payload[0] if payload else 0
        if not 1 <= number <= len(self._input_recipes):
            return _text(f"there is no input recipe {number}")
        recipe = self._input_recipes[number - 1]
        if len(payload) - 1 != recipe.layout.size:
            return _text(f"input recipe {number} has {recipe.layout.size} bytes, and not {len(payload) - 1}")
        values = recipe.unpack(payload[1:])
        for name in recipe.names:
            write = INPUTS[name].write
            if write is not None:
                write(self.controller, values)
            self.controller.touched(name, values[name])
        return b""


def _names(payload: bytes) -> list[str]:
    return [name for name in payload.decode("ascii", "replace").split(",") if name]


def _package(kind: str, payload: bytes) -> bytes:
    return _HEADER.pack(_HEADER.size + len(payload), ord(kind)) + payload


def _text(message: str) -> bytes:
    text, source = message.encode()[:255], b"RTDE"
    return _package("M", bytes([len(text)]) + text + bytes([len(source)]) + source + bytes([_WARNING]))
