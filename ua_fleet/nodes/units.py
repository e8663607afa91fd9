"""Engineering units as OPC UA clients know them: UNECE codes (OPC 10000-8 5.6.3)."""

from __future__ import annotations

from typing import Final

__all__ = ["UNECE_NAMESPACE", "unit_code", "unit_id"]

UNECE_NAMESPACE: Final = "http://www.opcfoundation.org/UA/units/un/cefact"

_CODES: Final = {
    "%": "P1",
    "m": "MTR",
    "mm": "MMT",
    "cm": "CMT",
    "km": "KMT",
    "m/s": "MTS",
    "km/h": "KMH",
    "m/s2": "MSK",
    "m/s²": "MSK",
    "rad": "C81",
    "rad/s": "2A",
    "rad/s2": "2B",
    "rad/s²": "2B",
    "deg": "DD",
    "°": "DD",
    "rpm": "RPM",
    "1/min": "RPM",
    "s": "SEC",
    "ms": "C26",
    "min": "MIN",
    "h": "HUR",
    "Hz": "HTZ",
    "°C": "CEL",
    "degC": "CEL",
    "K": "KEL",
    "V": "VLT",
    "mV": "2Z",
    "A": "AMP",
    "mA": "4K",
    "Ah": "AMH",
    "W": "WTT",
    "kW": "KWT",
    "Wh": "WHR",
    "kWh": "KWH",
    "J": "JOU",
    "N": "NEW",
    "Nm": "NU",
    "N·m": "NU",
    "Pa": "PAL",
    "bar": "BAR",
    "kg": "KGM",
    "g": "GRM",
    "l": "LTR",
    "dB": "2N",
    "lx": "LUX",
    "Ohm": "OHM",
    "T": "D33",
}
"""Symbols that robots' data comes in, with their common codes (UNECE Recommendation 20)."""


def unit_code(unit: str) -> str | None:
    """The UNECE common code of a unit, or None for one that has none here."""
    return _CODES.get(unit)


def unit_id(unit: str) -> int:
    """UnitId of EUInformation: the bytes of the common code as a number; -1 where there is none."""
    code = unit_code(unit)
    return -1 if code is None else int.from_bytes(code.encode("ascii"), "big")
