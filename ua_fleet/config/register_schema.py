"""Registers in `fleet.yaml`: where one value lies in a Modbus device, and how."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from ua_fleet.config.base import Model, ScalarType
from ua_fleet.config.shapes import all_of, given, implies, limited_to, none_of
from ua_fleet.registers import LAST_ADDRESS, ByteOrder, Register, RegisterType, Table

__all__ = ["Address", "RegisterConfig"]

Address = Annotated[int, Field(ge=0, le=LAST_ADDRESS)]

_TYPES: Final = {
    ScalarType.BOOLEAN: RegisterType.BOOL,
    ScalarType.INT16: RegisterType.INT16,
    ScalarType.UINT16: RegisterType.UINT16,
    ScalarType.INT32: RegisterType.INT32,
    ScalarType.UINT32: RegisterType.UINT32,
    ScalarType.INT64: RegisterType.INT64,
    ScalarType.UINT64: RegisterType.UINT64,
    ScalarType.FLOAT: RegisterType.FLOAT32,
    ScalarType.DOUBLE: RegisterType.FLOAT64,
    ScalarType.STRING: RegisterType.STRING,
}


class RegisterConfig(
    Model,
    frozen=True,
    json_schema_extra=all_of(
        {"properties": {"scale": {"not": {"const": 0}}}},
        implies(
            limited_to("table", Table.COIL, Table.DISCRETE),
            all_of(none_of("bit"), implies(given("type"), limited_to("type", RegisterType.BOOL))),
        ),
        implies(
            all_of(limited_to("table", Table.HOLDING, Table.INPUT), limited_to("type", RegisterType.BOOL)), given("bit")
        ),
        implies(limited_to("type", RegisterType.STRING), given("length")),
        implies(all_of(given("type"), given("length")), limited_to("type", RegisterType.STRING)),
        implies(all_of(given("type"), given("bit")), limited_to("type", RegisterType.BOOL)),
    ),
):
    """Where one value lies, and how."""

    table: Table = Field(examples=["holding"])
    """`coil` and `discrete` are bits, `holding` and `input` words of 16 bits; coils and holding registers can be
    written."""
    address: Address
    """Address on the wire, from 0: what manuals call holding register 40001 is 0."""
    type: RegisterType | None = None
    """What lies there; left out: what the field's type is, e.g. `float32` for a Float."""
    bit: int | None = Field(default=None, ge=0, le=15)
    """Of a `bool` in a word: 0 is the least significant bit."""
    length: int | None = Field(default=None, ge=1, le=125)
    """Of a `string`: words, each of two characters."""
    order: ByteOrder | None = None
    """How the bytes of 0xAABBCCDD lie in its words; left out: as the device has it."""
    scale: float = 1.0
    """The value is what lies in the register, times `scale`, plus `offset`."""
    offset: float = 0.0
    """See `scale`."""
    deadband: float = Field(default=0.0, ge=0)
    """A number that differs by no more from the last one is not handed on."""
    encoding: Literal["utf-8", "latin-1", "ascii"] = "utf-8"
    """Of a `string`."""

    @model_validator(mode="after")
    def _check(self) -> RegisterConfig:
        if self.scale == 0:
            raise ValueError("scale: with 0 nothing could be told apart")
        if self.table.is_bits:
            self._check_bits()
        elif self.type is RegisterType.BOOL and self.bit is None:
            raise ValueError("a bool in a word needs its `bit`, 0 to 15")
        if self.type is RegisterType.STRING and self.length is None:
            raise ValueError("a string needs its `length` in words")
        if self.type is not None:
            self._check_kind(self.type)
        return self

    def _check_kind(self, kind: RegisterType) -> None:
        if kind is not RegisterType.STRING and self.length is not None:
            raise ValueError("length: only a string has one")
        if kind is not RegisterType.BOOL and self.bit is not None:
            raise ValueError("bit: only a bool has one")
        if kind in (RegisterType.BOOL, RegisterType.STRING) and (self.is_scaled or self.deadband):
            raise ValueError("scale, offset and deadband are for numbers")

    def _check_bits(self) -> None:
        if self.type not in (None, RegisterType.BOOL):
            raise ValueError(f"type: a {self.table} is a bool")
        if self.bit is not None or self.length is not None or self.order is not None or self.is_scaled or self.deadband:
            raise ValueError(f"a {self.table} has no bit, length, order, scale, offset or deadband")

    @property
    def is_scaled(self) -> bool:
        """Whether the value is another number than what lies in the register."""
        return self.scale != 1.0 or self.offset != 0.0

    def register(self, order: ByteOrder, field: ScalarType) -> Register:
        """The register; raises ValueError where what is left out does not follow from the field's type.

        Args:
            order: of the device.
            field: type of the value.
        """
        kind = self.type or (RegisterType.BOOL if self.table.is_bits else _TYPES.get(field))
        if kind is None:
            raise ValueError(f"`type` is needed: a {field.value} follows from no register")
        if kind is RegisterType.BOOL and not self.table.is_bits and self.bit is None:
            raise ValueError("a Boolean in a word needs its `bit`, 0 to 15")
        if kind is RegisterType.STRING and self.length is None:
            raise ValueError("a String needs its `length` in words")
        self._check_kind(kind)
        return Register(
            self.table,
            self.address,
            kind,
            self.bit,
            self.length or 0,
            self.order or order,
            self.scale,
            self.offset,
            self.encoding,
        )
