"""What `ua-fleet config check` says of the registers of a skill's handshake."""

from __future__ import annotations

import pytest

from tests.config_problems import problems
from tests.unit.bridges.modbus.plc_fleet import HEAD

SKILL = """\
    skills:
      close:
        id: 20
        arguments: {force: {type: Double}}
        results: {way: {type: Double}}
        via:
          request: {table: holding, address: 10}
          accepted: {table: input, address: 10}
          busy: {table: discrete, address: 0}
          done: {table: discrete, address: 1}
          error: {table: discrete, address: 2}
          arguments: {force: {table: holding, address: 11, type: uint16, scale: 0.1}}
          results: {way: {table: input, address: 11, type: float32}}
"""
SKILLED = HEAD.replace("    data:\n", "") + SKILL


def test_skill_that_is_right() -> None:
    assert problems(SKILLED) == []


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        (
            "request: {table: holding",
            "request: {table: input",
            "via.request.table: input registers cannot be written; use holding or coil",
        ),
        (
            "request: {table: holding, address: 10",
            "request: {table: holding, address: 10, type: int32",
            "via.request: the number of an execution is a whole word; write `type: uint16`",
        ),
        (
            "force: {table",
            "forec: {table",
            "via.arguments: the argument `force` has no register; add it under `arguments`",
        ),
        (
            "force: {table: holding, address: 11",
            "force: {table: holding, address: 10",
            "via.arguments.force: holding 10 is written by",
        ),
        (
            "way: {table: input, address: 11",
            "way: {table: coil, address: 11",
            "via.results.way: type: a coil is a bool",
        ),
        ("request: {table: holding, address: 10}", "code: 3", "via.request: `request` is missing"),
        ("          arguments:", "          code: 3\n          arguments:", "via: command and code belong together"),
        (
            "          arguments:",
            "          command: {table: coil, address: 20}\n          code: 7\n          arguments:",
            "via.command: bool is no Int64",
        ),
        (
            "          accepted:",
            "          command: {table: holding, address: 9, type: uint16}\n          code: 70000\n          accepted:",
            "via.code: 70000 does not fit into uint16",
        ),
    ],
)
def test_skill_that_is_wrong(old: str, new: str, problem: str) -> None:
    assert old in SKILLED
    found = problems(SKILLED.replace(old, new, 1))
    assert any(problem in each for each in found), found


APART = """\
          request: {table: holding, address: 10}
          accepted: {table: holding, address: 11}
          busy: {table: holding, address: 12, type: bool, bit: 0}
          done: {table: holding, address: 12, type: bool, bit: 1}
          error: {table: holding, address: 12, type: bool, bit: 2}
          halt: {table: holding, address: 13}
          error_code: {table: holding, address: 12, type: uint16}
          command: {table: holding, address: 14, type: uint16}
          code: 1
"""
SIGNALLED = HEAD.replace("    data:\n", "") + "    skills:\n      close:\n        id: 20\n        via:\n" + APART


def test_signals_of_one_handshake_may_be_bits_of_one_word() -> None:
    assert problems(SIGNALLED) == []


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("address: 11", "address: 10", "accepted: holding 10 is `request`"),
        ("address: 13", "address: 11", "halt: holding 11 is `accepted`"),
        ("address: 12, type: bool, bit: 1", "address: 12, type: bool, bit: 0", "done: holding 12 bit 0 is `busy`"),
        ("address: 12, type: bool, bit: 2", "address: 12, type: bool, bit: 1", "error: holding 12 bit 1 is `done`"),
        ("address: 12, type: bool, bit: 0", "address: 11, type: bool, bit: 0", "busy: holding 11 bit 0 is `accepted`"),
        ("address: 14", "address: 11", "command: holding 11 is `accepted`"),
    ],
)
def test_two_signals_of_one_handshake_at_one_place(old: str, new: str, problem: str) -> None:
    assert SIGNALLED.count(old) == 1
    found = [each.partition("skills.close.via.")[2] for each in problems(SIGNALLED.replace(old, new))]
    assert found == [f"{problem} of this handshake already; one of the two addresses or bits is wrong"]


def test_skills_of_one_handshake_share_its_registers() -> None:
    second = SKILL.replace("    skills:\n", "").replace("close:", "open:").replace("id: 20", "id: 21")
    shared = (SKILL + second).replace("type: float32", "type: float32")
    assert problems(SKILLED.replace(SKILL, shared)) == []
    command = "          command: {table: holding, address: 20}\n          code: 1\n"
    found = problems(SKILLED.replace(SKILL, SKILL + command + second))
    text = "`command` is missing; robots.press.skills.close.via has the same `request` and leaves its code there"
    assert found == [f"38:robots.press.skills.open.via: {text}; give each of them its `code`"]
    apart = second.replace("request: {table: holding, address: 10}", "request: {table: holding, address: 30}")
    found = problems(SKILLED.replace(SKILL, SKILL + apart))
    assert any("via.arguments.force: holding 11 is written by" in each for each in found), found
