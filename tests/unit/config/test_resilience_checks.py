"""`resilience` held against the robots of the file: all problems at once, each at its line."""

from __future__ import annotations

import pytest

from ua_fleet.config.load import load_content
from ua_fleet.errors import ConfigInvalid

FLEET = """\
version: 1
pubsub: {security: none}
bridges:
  floor: {kind: ros2, space: 2, status_id: 1}
robots:
  ur3:
    bridge: floor
    skill_status_id: 2
    skills: {go: {id: 3, arguments: {to: {type: String}}}}
    data:
      battery: {id: 10, type: Double}
      joints: {id: 11, type: Double, array: true}
      door: {id: 12, type: Boolean, gives: [mobile, thermometer]}
      blob: {id: 13, type: ByteString}
      pose: {id: 14, fields: {x: {type: Double}, y: {type: Double}}}
  drone:
    bridge: floor
    data: {battery: {id: 20, type: Double}}
resilience:
"""


def problems(section: str) -> list[str]:
    """What is wrong with `resilience`, without the file's name."""
    try:
        load_content((FLEET + section).encode(), "f.yaml", {})
    except ConfigInvalid as error:
        return [str(problem).removeprefix("f.yaml:") for problem in error.problems]
    return []


def test_what_some_robot_has_is_no_mistake() -> None:
    assert not problems("""\
  criteria:
    battery: {kind: benefit, range: [0, 100], value: battery}
    bent: {kind: cost, range: [0, 3], value: "joints[1]"}
    far: {kind: cost, range: [0, 9], distance: {x: pose.x, y: pose.y, argument: to, places: {dock: [0, 1]}}}
  judgements: {battery: {bent: 2, far: 2}, bent: {far: 1}}
  faults:
    low: {robots: [ur3, drone], when: battery < 20, until: battery > 30}
    shut: {robots: [ur3], when: "not ur3.door and joints[0] > 1.5"}
    cold: {robots: [drone], when: "ur3.joints[1] < 0"}
""")


def test_all_mistakes_are_told_at_once_with_their_lines() -> None:
    assert problems("""\
  critera: {}
  criteria:
    battery: {kind: benefit, value: battery}
    charge: {kind: benefit, range: [0, 100], value: batery}
    far: {kind: cost, range: [0, 9], distance: {x: pose.x, y: pose.z, argument: too, places: {dock: [0, 1]}}}
    near: {kind: cost, range: [0, 9], distance: {x: pose.x, y: pose.y, places: {dock: [0, 1]}}}
  faults:
    low: {robots: [ur3, dron], when: batery < 20}
    bent: {robots: [ur3], when: joints > 3, until: "battery[0] > 1"}
    odd: {robots: [drone], when: blob > 1 and ur3.batery < 1}
    blob: {robots: [ur3], when: blob > 1}
    silent: {robots: [ur3], when: battery < 1}
    bad: {robots: [ur3], when: "battery <"}
    not_halted: {robots: [ur3], when: battery < 1}
""") == [
        "20:resilience.critera: unknown key `critera`; did you mean `criteria`?",
        "22:resilience.criteria.battery.range: `range` is missing; add `range: ...`",
        (
            "23:resilience.criteria.charge.value: no robot has a number `batery`: ur3 has no value `batery`;"
            " did you mean `battery`?"
        ),
        (
            "24:resilience.criteria.far.distance.y: no robot has a number `pose.z`: ur3 has no value `pose.z`;"
            " did you mean `pose.y`?"
        ),
        "24:resilience.criteria.far.distance.argument: no skill has an argument `too`; did you mean `to`?",
        (
            "25:resilience.criteria.near.distance.places: `places` is without use where `argument` is missing; add"
            " `argument`, or remove it"
        ),
        "27:resilience.faults.low.robots[1]: there is no robot `dron`; did you mean `drone`?",
        "27:resilience.faults.low.when: ur3 has no value `batery`; did you mean `battery`?",
        "28:resilience.faults.bent.when: `joints` of ur3 is an array; write joints[0] for its first element",
        "28:resilience.faults.bent.until: `battery` of ur3 is no array; write battery",
        "29:resilience.faults.odd.when: drone has no value `blob`; it has: `battery`",
        "29:resilience.faults.odd.when: ur3 has no value `batery`; did you mean `battery`?",
        "30:resilience.faults.blob.when: `blob` of ur3 is a ByteString, which cannot be used here",
        "31:resilience.faults.silent: `silent` is found by the program itself; choose another name",
        "32:resilience.faults.bad: 'battery <' is no condition; write e.g. temperature > 20",
        "33:resilience.faults.not_halted: `not_halted` is found by the program itself; choose another name",
    ]


@pytest.mark.parametrize("limit_s", ["1e12", "200000000001", ".inf", "1e999", ".nan"])
def test_how_long_people_may_think_ends_before_times_do(limit_s: str) -> None:
    (told,) = problems(f"  limit_s: {limit_s}\n")
    assert told.startswith("20:resilience.limit_s: must be ")
    assert ("at most 2e+11" in told) is (limit_s[0] in "12" and limit_s != "1e999")
    assert not problems("  limit_s: 2e11\n"), "the highest that works"


def test_criteria_are_for_capacities_and_skills_that_some_robot_has() -> None:
    assert not problems("""\
  criteria:
    battery: {kind: benefit, range: [0, 100], value: battery, missing: neutral, capacities: [mobile, thermometer]}
    bent: {kind: cost, range: [0, 3], value: "joints[1]", missing: exclude, skills: [go]}
  judgements: {battery: {bent: 2}}
""")
    assert problems("""\
  criteria:
    battery: {kind: benefit, range: [0, 100], value: battery, missing: best, capacities: [mobil]}
    bent: {kind: cost, range: [0, 3], value: "joints[1]", capacities: [mobile, fly], skills: [gone]}
  judgements: {battery: {bent: 2}}
""") == [
        "21:resilience.criteria.battery.missing: `best` is not allowed; allowed: `worst`, `neutral`, `exclude`",
        "22:resilience.criteria.bent.capacities[1]: no robot has the capacity `fly`; known: `mobile`, `thermometer`",
        "22:resilience.criteria.bent.skills[0]: no robot has the skill `gone`; did you mean `go`?",
    ]


def test_a_fault_takes_away_what_each_of_its_robots_has() -> None:
    assert not problems("  faults:\n    hot: {robots: [ur3], when: battery < 1, capacities: [mobile]}\n")
    assert problems("  faults:\n    hot: {robots: [ur3, drone], when: battery < 1, capacities: [mobil, mobile]}\n") == [
        "21:resilience.faults.hot.capacities[0]: ur3 lacks the capacity `mobil`; did you mean `mobile`?",
        "21:resilience.faults.hot.capacities[0]: drone lacks the capacity `mobil`; it has: none",
        "21:resilience.faults.hot.capacities[1]: drone lacks the capacity `mobile`; it has: none",
    ]


def test_data_with_problems_of_its_own_is_not_complained_about_twice() -> None:
    text = FLEET.replace("battery: {id: 20, type: Double}", "battery: {id: 20, type: Duble}")
    with pytest.raises(ConfigInvalid) as caught:
        load_content(f"{text}  faults: {{low: {{robots: [drone], when: battery < 2}}}}\n".encode(), "f.yaml", {})
    (problem,) = caught.value.problems
    assert "`Duble` is not allowed" in str(problem)


def test_judgements_have_their_line() -> None:
    said = problems("""\
  criteria:
    battery: {kind: benefit, range: [0, 100], value: battery}
    free: {kind: benefit, range: [0, 100], tasks_ahead: true}

  judgements: {battery: {fre: 2}}
""")
    assert said == ["24:resilience.judgements: 'fre' is not among 'battery', 'free'"]


def test_the_sections_may_be_empty() -> None:
    assert not problems("  criteria:\n  faults:\n")
    (said,) = problems("  criteria: {}\n")
    assert said.startswith("20:resilience.criteria: ")
    (said,) = problems("  faults: [low]\n")
    assert said == "20:resilience.faults: must have keys with values"
