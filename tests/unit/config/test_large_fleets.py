"""What a fleet costs to read grows with its size, and not faster: of 1,000 robots it took 38 s in place of 1 s."""

from __future__ import annotations

from pathlib import Path

from tests.counted_lines import counted_lines
from ua_fleet.config.load import load

_HEAD = """
version: 1
pubsub: {security: none}
bridges:
  hall: {kind: ros2, space: 2, status_id: 65500}
resilience:
  criteria:
    charge: {value: value0, kind: benefit, range: [0, 100]}
  faults:
    hot: {robots: [ROBOTS], when: value1 > 5, until: value1 < 4, capacities: [mobile]}
robots:
"""
_ROBOT = """
  R{robot:03d}:
    bridge: hall
    capacities: [mobile]
    skill_status_id: {first}
    data:
      value0: {{id: {a}, type: Double, unit: "%", limits: {{high: 90, fault: [mobile]}}}}
      value1: {{id: {b}, type: Double, gives: [warm]}}
      value2: {{id: {c}, type: Boolean, normal: true}}
    skills:
      go: {{id: {d}, needs: [mobile, warm]}}
"""


def _lines_of(folder: Path, robots: int) -> int:
    """Lines of the program that run while such a fleet is read and checked."""
    path = folder / f"fleet{robots}.yaml"
    text = _HEAD.replace("ROBOTS", ", ".join(f"R{robot:03d}" for robot in range(robots)))
    for robot in range(robots):
        first, a, b, c, d = range(5 * robot + 1, 5 * robot + 6)
        text += _ROBOT.format(robot=robot, first=first, a=a, b=b, c=c, d=d)
    path.write_text(text)
    count = counted_lines(lambda: load(path))
    assert len(load(path).robots) == robots
    return count


def test_a_fleet_twice_as_large_takes_twice_as_many_steps(tmp_path: Path) -> None:
    _lines_of(tmp_path, 2)  # what is done once
    assert _lines_of(tmp_path, 100) < 2.1 * _lines_of(tmp_path, 50)
