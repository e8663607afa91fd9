"""The tables that PLCs see, and who may do what with them."""

from __future__ import annotations

from typing import Any

import pytest

from tests.config_problems import problems
from ua_fleet.config.load import load_content
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.table import map_rows
from ua_fleet.registers import AddressSpan, Register, RegisterType, Table

WORD = Register(Table.HOLDING, 4, RegisterType.INT32)
BIT = Register(Table.HOLDING, 8, RegisterType.BOOL, bit=3)
INPUT = Register(Table.INPUT, 2, RegisterType.UINT16)


@pytest.mark.parametrize(
    ("span", "reads", "writes"),
    [
        (AddressSpan(Table.HOLDING, 4, 2), True, True),
        (AddressSpan(Table.HOLDING, 4, 1), True, True),
        (AddressSpan(Table.HOLDING, 3, 2), True, False),
        (AddressSpan(Table.HOLDING, 8, 1), True, True),
        (AddressSpan(Table.HOLDING, 9, 1), False, False),
        (AddressSpan(Table.INPUT, 0, 3), True, False),
        (AddressSpan(Table.INPUT, 0, 4), False, False),
        (AddressSpan(Table.COIL, 0, 1), False, False),
    ],
)
def test_what_may_be_read_and_written(span: AddressSpan, reads: bool, writes: bool) -> None:
    image = Image([INPUT], [WORD, BIT])
    assert image.has(span) is reads
    assert image.can_write(span) is writes


FLEET = """\
version: 1
pubsub: {security: none}
bridges: {cell: {kind: ros1, status_id: 1}}
robots:
  arm:
    bridge: cell
    skill_status_id: 2
    data:
      angle: {id: 3, type: Double, unit: deg}
      pose: {id: 4, fields: {x: {type: Float}}}
      goal: {id: 5, type: Double, origin: server}
      joints: {id: 7, type: Double, array: true}
    skills:
      turn: {id: 6, arguments: {to: {type: Double}}, results: {at: {type: Double}}}
modbus:
  robots: [arm]
  values: {arm.angle: {table: input, address: 60, type: int16, scale: 0.1}}
  sets: {arm.goal: {table: holding, address: 10, type: int16}}
  commands:
    turn: {code: 1, robot: arm, skill: turn, arguments: {to: {table: holding, address: 20}}}
"""


def test_a_map_that_is_right() -> None:
    assert problems(FLEET) == []
    rows = map_rows(load_content(FLEET.encode(), "F", {}))
    assert ("arm.angle", 60) in [(row.name, row.register.address) for row in rows]
    assert ("arm.angle is Good", 0) in [(row.name, row.register.address) for row in rows]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[arm]", "[amr]", "16:modbus.robots[0]: there is no robot `amr`; did you mean `arm`?"),
        ("[arm]", "[arm, arm]", "16:modbus.robots[1]: arm is named twice; remove one of them"),
        ("{arm.angle:", "{amr.angle:", "17:modbus.values.amr.angle: there is no robot `amr`; did you mean `arm`?"),
        ("{arm.angle:", "{arm.anlge:", "17:modbus.values.arm.anlge: arm has no data `anlge`; did you mean `angle`?"),
        (
            "{arm.angle:",
            "{arm.pose:",
            "17:modbus.values.arm.pose: arm.pose has no field ``; name one of its fields: `x`",
        ),
        ("{arm.angle:", "{arm.joints:", "17:modbus.values.arm.joints: registers hold no arrays; name another value"),
        ("input, address: 60", "holding, address: 60", "17:modbus.values.arm.angle.table: holding is not for this"),
        (
            "input, address: 60",
            "input, address: 49",
            "17:modbus.values.arm.angle: input 49 overlaps the words of answers",
        ),
        ("{arm.goal:", "{arm.angle:", "18:modbus.sets.arm.angle: arm.angle is the robot's own"),
        (
            "holding, address: 10",
            "holding, address: 3",
            "18:modbus.sets.arm.goal: holding 3 overlaps the words of commands",
        ),
        (
            "skill: turn,",
            "skill: trun,",
            "20:modbus.commands.turn.skill: arm has no skill `trun`; did you mean `turn`?",
        ),
        (
            "arguments: {to: {table: holding, address: 20}}",
            "arguments: {}",
            "20:modbus.commands.turn.arguments: the argument `to` has no register and no default",
        ),
        ("{to: {table: holding, address: 20}}", "{to: {table: holding, address: 9}}", "overlaps"),
        ("code: 1", "code: 0", "20:modbus.commands.turn.code: must be at least 1, not 0"),
        ("robot: arm, skill: turn", "scenario: s, skill: turn", "20:modbus.commands.turn: give either"),
        ("  robots: [arm]", "  robots: [arm]\n  writers: [10.0.0]", "17:modbus.writers[0]: 10.0.0 is no address"),
    ],
)
def test_each_mistake_is_said_with_its_line(old: str, new: str, problem: str) -> None:
    assert old in FLEET
    found = problems(FLEET.replace(old, new, 1))
    assert any(problem in each for each in found), found


def test_commands_share_their_arguments_registers() -> None:
    second = "    back: {code: 2, robot: arm, skill: turn, arguments: {to: {table: holding, address: 20}}}\n"
    assert problems(FLEET + second) == []
    same: list[Any] = problems(FLEET + second.replace("code: 2", "code: 1"))
    assert same == ["21:modbus.commands.back.code: 1 is that of `turn`; choose another number"]
