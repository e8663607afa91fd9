"""A PLC in a process of its own: `python -m ua_demo.simulators.modbus`.

It has the four tables, a server with the real protocol (TCP, TLS or a serial line) and a cyclic program that does
skills by handshake as docs/plc.md describes. It knows nothing of a fleet.
"""

from ua_demo.simulators.modbus.memory import Memory
from ua_demo.simulators.modbus.program import Conveyor, HandshakeLayout, HandshakeProgram, Work
from ua_demo.simulators.modbus.server import PlcServer, make_server

__all__ = ["Conveyor", "HandshakeLayout", "HandshakeProgram", "Memory", "PlcServer", "Work", "make_server"]
