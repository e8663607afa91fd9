"""Values in Modbus registers: where they lie, how they are converted, and in how few requests they are read. Pure.

Both sides stand on it: the bridge that reads PLCs, and the server that PLCs read. Nothing here knows a socket, a
library of Modbus or `fleet.yaml`.
"""

from ua_fleet.registers.convert import (
    Cell,
    RegisterUnfit,
    cast,
    decode,
    encode,
    fit_problem,
    make_cast,
    make_decoder,
    make_encoder,
)
from ua_fleet.registers.model import LAST_ADDRESS, AddressSpan, ByteOrder, Register, RegisterType, Table
from ua_fleet.registers.plan import DeviceLimits, fits_device, plan_reads
from ua_fleet.registers.tables import TABLE_OF_FUNCTION, Tables

__all__ = [
    "LAST_ADDRESS",
    "TABLE_OF_FUNCTION",
    "AddressSpan",
    "ByteOrder",
    "Cell",
    "DeviceLimits",
    "Register",
    "RegisterType",
    "RegisterUnfit",
    "Table",
    "Tables",
    "cast",
    "decode",
    "encode",
    "fit_problem",
    "fits_device",
    "make_cast",
    "make_decoder",
    "make_encoder",
    "plan_reads",
]
