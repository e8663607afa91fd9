"""Registers as Modbus has them: four tables of bits and 16-bit words, and the values that lie in them. Pure.

Addresses are those on the wire, from 0 (MODBUS Application Protocol 1.1b3, 4.4): what a manual calls holding register
40001 has the address 0. The words of a value stand side by side; in which order, and the bytes within each word, the
device decides (`ByteOrder`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

__all__ = [
    "LAST_ADDRESS",
    "AddressSpan",
    "ByteOrder",
    "Register",
    "RegisterType",
    "Table",
]

LAST_ADDRESS: Final = 0xFFFF


class Table(StrEnum):
    """The four tables of a device."""

    COIL = "coil"
    """Bits that can be written."""
    DISCRETE = "discrete"
    """Discrete inputs: bits that can only be read."""
    HOLDING = "holding"
    """Words that can be written."""
    INPUT = "input"
    """Input registers: words that can only be read."""

    @property
    def is_bits(self) -> bool:
        """Whether an address is a bit, and no word."""
        return self in (Table.COIL, Table.DISCRETE)

    @property
    def is_writable(self) -> bool:
        """Whether the protocol has a function that writes it."""
        return self in (Table.COIL, Table.HOLDING)


class RegisterType(StrEnum):
    """What lies in a register, or in several side by side."""

    BOOL = "bool"
    INT16 = "int16"
    UINT16 = "uint16"
    INT32 = "int32"
    UINT32 = "uint32"
    INT64 = "int64"
    UINT64 = "uint64"
    FLOAT32 = "float32"
    FLOAT64 = "float64"
    STRING = "string"

    @property
    def words(self) -> int:
        """Words of a value; 0 for a string, whose length is given."""
        return _WORDS[self]

    @property
    def is_integer(self) -> bool:
        """Whether it is a whole number."""
        return "int" in self.value

    @property
    def integer_range(self) -> tuple[int, int]:
        """Least and greatest value of an integer type."""
        bits = 16 * self.words
        return (0, 2**bits - 1) if self.value.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


_WORDS: Final = {
    RegisterType.BOOL: 1,
    RegisterType.INT16: 1,
    RegisterType.UINT16: 1,
    RegisterType.INT32: 2,
    RegisterType.UINT32: 2,
    RegisterType.INT64: 4,
    RegisterType.UINT64: 4,
    RegisterType.FLOAT32: 2,
    RegisterType.FLOAT64: 4,
    RegisterType.STRING: 0,
}


class ByteOrder(StrEnum):
    """How the bytes of a value lie in its words, written for the value 0xAABBCCDD.

    Words of four-word values follow in the same sense. A string's words are never turned, only the bytes in each.
    """

    ABCD = "ABCD"
    """The most significant word first, in each word the most significant byte first: as the protocol has it."""
    CDAB = "CDAB"
    """The least significant word first."""
    BADC = "BADC"
    """The most significant word first, in each word the least significant byte first."""
    DCBA = "DCBA"
    """All the other way round."""

    @property
    def swaps_words(self) -> bool:
        """Whether the least significant word comes first."""
        return self in (ByteOrder.CDAB, ByteOrder.DCBA)

    @property
    def swaps_bytes(self) -> bool:
        """Whether the least significant byte of each word comes first."""
        return self in (ByteOrder.BADC, ByteOrder.DCBA)


@dataclass(frozen=True, slots=True, order=True)
class AddressSpan:
    """Addresses side by side in one table."""

    table: Table
    address: int
    count: int

    @property
    def end(self) -> int:
        """The first address after it."""
        return self.address + self.count

    def overlaps(self, other: AddressSpan) -> bool:
        """Whether an address is in both."""
        return self.table is other.table and self.address < other.end and other.address < self.end

    @property
    def text(self) -> str:
        """For people: `holding 100`, `holding 100 to 103`."""
        return f"{self.table} {self.address}" + (f" to {self.end - 1}" if self.count > 1 else "")


@dataclass(frozen=True, slots=True)
class Register:
    """Where one value lies, and how."""

    table: Table
    address: int
    type: RegisterType
    bit: int | None = None
    """Of a bool in a word: 0 is the least significant bit."""
    length: int = 0
    """Words of a string."""
    order: ByteOrder = ByteOrder.ABCD
    scale: float = 1.0
    """The value is what lies in the register, times `scale`, plus `offset`."""
    offset: float = 0.0
    encoding: str = "utf-8"
    """Of a string."""

    @property
    def is_scaled(self) -> bool:
        """Whether the value is another number than what lies in the register."""
        return self.scale != 1.0 or self.offset != 0.0

    @property
    def span(self) -> AddressSpan:
        """The addresses that it takes."""
        return AddressSpan(self.table, self.address, 1 if self.table.is_bits else self.type.words or self.length)
