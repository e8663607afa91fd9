"""A fleet with a Modbus device, for the tests here."""

from __future__ import annotations

HEAD = """\
version: 1
pubsub: {security: none}
bridges:
  plc:
    kind: modbus
    space: 300
    status_id: 1
    devices: {plc: {host: 10.0.0.7, holding_registers: [[0, 99]], write_words: 10}}
  two:
    kind: modbus
    space: 301
    status_id: 2
    devices: {a: {host: 10.0.0.8}, b: {host: 10.0.0.9, order: CDAB}}
    polls: {fast: {period_s: 0.1}}
robots:
  press:
    bridge: plc
    skill_status_id: 3
    data:
"""
"""19 lines; what a test adds begins on line 20."""
