"""Templates of topics: what is refused, and that no two values share a topic."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.fleet.fleet_of import ROBOTS, fleet_config
from ua_fleet.config.nodes import fleet_model
from ua_fleet.uns.topics import DEFAULT_TEMPLATE, NamespaceTopics, template_problem

NAMES = st.from_regex(r"[A-Za-z][A-Za-z0-9_-]{0,63}", fullmatch=True)
LEVELS = st.permutations(["{fleet}", "{robot}", "{data}", "hall"])


@pytest.mark.parametrize(
    ("template", "site", "text"),
    [
        ("{fleet}/{robot}", None, "add {data} as a level"),
        ("{fleet}/{data}", None, "add {robot} as a level"),
        ("{robot}/{robot}/{data}", None, "{robot} stands there twice"),
        ("{robot}-{data}", None, "a placeholder is a whole level"),
        ("{robot}/{data", None, "a placeholder is a whole level"),
        ("{robot}/{data}/{}", None, "no placeholder"),
        ("{robott}/{data}", None, "did you mean `robot`?"),
        ("{robot}//{data}", None, "empty level"),
        ("/{robot}/{data}", None, "empty level"),
        ("", None, "empty level"),
        ("+/{robot}/{data}", None, "wildcard"),
        ("{robot}/{data}/#", None, "wildcard"),
        ("hall 2/{robot}/{data}", None, "a space"),
        ("hall\0/{robot}/{data}", None, "control character"),
        ("$SYS/{robot}/{data}", None, "begins with $"),
        (f"{'x' * 513}/{{robot}}/{{data}}", None, "longer than 512 bytes"),
        (DEFAULT_TEMPLATE, None, "write `site` too"),
        ("{robot}/{data}", "plant", "`site` has no place"),
        (DEFAULT_TEMPLATE, "a//b", "site 'a//b': it has an empty level"),
        (DEFAULT_TEMPLATE, "a/#", "wildcard"),
        (DEFAULT_TEMPLATE, "{fleet}", "write the name itself"),
        (DEFAULT_TEMPLATE, "$share/g", "begins with $"),
        (DEFAULT_TEMPLATE, "x" * 513, "longer than 512 bytes"),
    ],
)
def test_a_template_that_cannot_be_is_refused_with_what_to_write(template: str, site: str | None, text: str) -> None:
    assert text in template_problem(template, site)


def test_the_topics_of_a_fleet() -> None:
    assert template_problem(DEFAULT_TEMPLATE, "acme/lyon") == ""
    topics = NamespaceTopics(DEFAULT_TEMPLATE, "acme/lyon", "Hall")
    assert topics.server == "acme/lyon/Hall/_server"
    (rover,) = fleet_model(fleet_config(ROBOTS)).robots
    found = [topics.of_field("rover", data_set, field) for data_set in rover.data_sets for field in data_set.fields]
    assert [topic.removeprefix("acme/lyon/Hall/rover/") for topic in found] == [
        "speed",
        "busy",
        "pose.x",
        "pose.frame",
        "ranges",
        "count",
        "goal",
    ]
    assert NamespaceTopics("{data}/of/{robot}", None, "Hall").server == "_server"


@given(LEVELS, st.sets(st.tuples(NAMES, NAMES), min_size=1, max_size=20))
def test_no_two_values_share_a_topic_whatever_the_template_is(levels: list[str], values: set[tuple[str, str]]) -> None:
    template = "/".join(levels)
    assert template_problem(template, None) == ""
    topics = NamespaceTopics(template, None, "Hall")
    made = {topics.topic(robot, data) for robot, data in values}
    assert len(made) == len(values)
    assert topics.server not in made
