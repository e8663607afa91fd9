"""What is told of mistakes in `fleet.yaml` about plugged-in devices."""

from __future__ import annotations

import pytest

from ua_fleet.config.load import load_content
from ua_fleet.errors import ConfigInvalid

FLEET = """\
version: 1
pubsub: {security: none}
bridges:
  pc: {kind: plugged, space: 300, status_id: 1, devices: {box: {path: /dev/box}}}
robots:
  rover_pc:
    bridge: pc
    skill_status_id: 9
    data:
      level: {id: 10, type: Double, source: {device: box, line: "L {value}"}}
      lamp: {id: 11, type: Boolean, origin: server, sink: {device: box, command: "LED {value}"}}
    skills:
      read: {id: 12, results: {value: {type: Double}}, via: {read: level}}
      beep: {id: 13, arguments: {ms: {type: Int32}}, via: {device: box, command: "BEEP {ms}"}}
"""


def problems(text: str) -> list[str]:
    try:
        load_content(text.encode(), "f.yaml", {})
    except ConfigInvalid as error:
        return [str(problem) for problem in error.problems]
    return []


def test_it_is_valid() -> None:
    assert problems(FLEET) == []


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("device: box, line", "device: bok, line", "the bridge has no device `bok`; did you mean `box`?"),
        ('line: "L {value}"', 'line: "L {valu}"', "{valu} is no result of the skill; did you mean `value`?"),
        ('line: "L {value}"', 'line: "L"', "the field `value` stands nowhere in it; write {value} into it"),
        ('line: "L {value}"', "plugged: true", "`plugged` is no Double; its type is Boolean"),
        ('line: "L {value}"', 'url: "rtsp://a/b"', "`url` is no Double; its type is String"),
        ('line: "L {value}"', 'line: "L {value}", url: "rtsp://a/b"', "exactly one of line, attribute, signal, url"),
        ('device: box, line: "L {value}"', "signal: trbots", "signal"),
        ('device: box, line: "L {value}"', "attribute: temp1_input", "`attribute` needs the name of one of"),
        ('line: "L {value}"', "attribute: ../../etc/passwd", "attribute"),
        ("via: {read: level}", "via: {read: lewel}", "the robot has no data `lewel` to read; did you mean `level`?"),
        ("{value: {type: Double}}, via", "{level: {type: Double}}, via", "the results are not the fields of `level`"),
        ('"BEEP {ms}"', '"BEEP"', "the argument `ms` stands nowhere in it; write {ms} into it"),
        ('"LED {value}"', '"LED {on}"', "{on} is no argument of the skill"),
        ("path: /dev/box", "match: {subsystem: tty}", "would take any device of tty; say which"),
        ("path: /dev/box", 'match: {vendor: "1"}, path: x', "vendor"),
        ("space: 300", "space: 30", "a vendor space of its own, 256 to 65535"),
        ("    bridge: pc\n", "    bridge: pc\n    mounted_on: rover\n", "there is no robot `rover`"),
        ("    bridge: pc\n", "    bridge: pc\n    mounted_on: rover_pc\n", "a robot is not mounted on itself"),
        ("id: 12,", "id: 12, needs: [temperature],", "rover_pc lacks the capacity `temperature`"),
    ],
)
def test_each_mistake_is_told_with_its_place(before: str, after: str, said: str) -> None:
    assert before in FLEET
    told = problems(FLEET.replace(before, after, 1))
    assert any(said in problem for problem in told), told
    assert all(problem.startswith("f.yaml:") and "\n" not in problem for problem in told)


def test_a_skill_may_need_what_data_gives() -> None:
    needs = FLEET.replace("id: 12,", "id: 12, needs: [temperature],")
    assert problems(needs.replace("id: 10,", "id: 10, gives: [temperature],")) == []
    assert "gives no capacity" in problems(FLEET.replace("id: 11,", "id: 11, gives: [light],"))[0]
