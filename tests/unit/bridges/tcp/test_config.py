"""What `config check` finds wrong with a TCP bridge."""

from __future__ import annotations

import pytest

from tests.unit.bridges.tcp.tcp_fleet import FILE, fleet
from ua_fleet.errors import ConfigInvalid

INTERPRETER = '    interpreter: {connect: "127.0.0.1:1025"}\n'
DIRECT = '    direct: {connect: "127.0.0.1:30002", language: urscript}\n'


def test_a_file_without_mistakes() -> None:
    config = fleet()
    assert config.bridges["cell"].space == 300


@pytest.mark.parametrize(
    ("old", "new", "key", "reason"),
    [
        ("space: 300", "space: 5", "bridges.cell.space", "vendor space"),
        (INTERPRETER + DIRECT, "", "bridges.cell", "give `direct`, `interpreter` or both"),
        (INTERPRETER, "", "robots.arm.skills.work", "no `interpreter`, and the skill no `via.direct`"),
        (DIRECT, "", "robots.arm.skills.move.via.direct", "no `direct`, the socket that takes commands"),
        (INTERPRETER, "    interpreter: {}\n", "bridges.cell.interpreter", "give either `connect`"),
        (
            INTERPRETER,
            '    interpreter: {listen: "0.0.0.0:4000"}\n',
            "bridges.cell.interpreter",
            "only that address may connect",
        ),
        (
            INTERPRETER,
            '    interpreter: {listen: "0.0.0.0:4000", peer: localhost}\n',
            "bridges.cell.interpreter.peer",
            "localhost is no IP address; write that of the robot",
        ),
        (
            INTERPRETER,
            '    interpreter: {listen: "[::]:4000", peer: "::ffff:10.0.0.7"}\n',
            "bridges.cell.interpreter",
            "peer: ::ffff:10.0.0.7 cannot reach [::]:4000; write both as IPv4, or both as IPv6",
        ),
        (
            INTERPRETER,
            '    interpreter: {connect: "127.0.0.1"}\n',
            "bridges.cell.interpreter.connect",
            "",
        ),
        (
            INTERPRETER,
            '    interpreter: {connect: "127.0.0.1:70000"}\n',
            "bridges.cell.interpreter.connect",
            "a port is 1 to 65535",
        ),
        ("other.temperature]", "arm.position]", "bridges.cell.answers", "data of this bridge's own robot"),
        (
            "temperature: {id: 90, type: Double}",
            "temperature: {id: 90, type: DateTime}",
            "bridges.cell.answers",
            "no fields",
        ),
        ("other.temperature]", "other.temprature]", "bridges.cell.answers", "did you mean `other.temperature`"),
        ("{angle}, {name}", "{angel}, {name}", "robots.arm.skills.move.via.direct.command", "did you mean `angle`"),
        ("{angle}, {name}", "{angle}", "robots.arm.skills.move.via.direct.command", "`name` stands nowhere"),
        ("OK {reached}", "OK", "robots.arm.skills.move.via.direct.done", "`reached` stands nowhere"),
        ("OK {reached}", "OK {reached:.3f}", "robots.arm.skills.move.via.direct.done", "has no format"),
        ("ERR {message}", "ERR {text}", "robots.arm.skills.move.via.direct.failed", "is no result"),
        ('            done: "OK {reached}"\n', "", "robots.arm.skills.move.via.direct", "without `done`"),
        ("COUNT {value}", "COUNT {count}", "robots.arm.data.count.source.direct.line", "is no result"),
        ("{value:.2f}", "{value:d}", "robots.arm.data.speed.sink.direct.command", "no format for a Double"),
        ("x: {type: Double}", "x: {type: Double, array: true}", "robots.arm.data.position.fields.x", "no arrays"),
        ("x: {type: Double}", "x: {type: DateTime}", "robots.arm.data.position.fields.x.type", "no DateTime"),
        ("position: {id: 10", "fault: {id: 10", "robots.arm.data.fault", "knows robots.arm.fault_id as `fault` too"),
        ("text: {id: 13, type: String, origin: server}", "text: {id: 13, type: String, sink: {}}", "", "origin"),
        ("home()\\n", "home({number:04d})\\n", "", ""),
    ],
)
def test_each_mistake_is_told_with_its_place(old: str, new: str, key: str, reason: str) -> None:
    if not key and not reason:
        fleet((old, new))
        return
    with pytest.raises(ConfigInvalid) as caught:
        fleet((old, new))
    told = [problem for problem in caught.value.problems if reason in str(problem)]
    assert told, str(caught.value)
    assert any(problem.key.startswith(key) for problem in told), str(caught.value)
    assert all(problem.line > 0 for problem in told)


def test_two_names_for_one_thing_of_the_robot() -> None:
    with pytest.raises(ConfigInvalid, match="give one of them another `subtype`"):
        fleet(("        arguments: {what", "        via: {subtype: lift}\n        arguments: {what"), _second_skill())


def _second_skill() -> tuple[str, str]:
    home = FILE.splitlines()[-1] + "\n"
    return home, home + "      lift: {id: 33}\n"
