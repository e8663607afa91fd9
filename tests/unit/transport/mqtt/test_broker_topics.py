"""The topics of a broker."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.errors import TransportError
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.topics import Kind, Place, TopicTree, level_of

TREE = TopicTree()
SOURCE = Topic(1, 2, 1005)
SPACES = st.integers(0, 232) | st.integers(256, 65_535)
SOURCES = st.builds(Topic, SPACES, st.integers(1, 65_535), st.integers(1, 65_535))
QUEUES = ["{topic}", "hall2/{topic}", "a/{space}/{ns}/{id}", "x-{topic}/value", "{id}.{ns}.{space}"]


def test_data_goes_to_the_papers_topic_and_the_rest_to_the_standards() -> None:
    assert TREE.queue(SOURCE) == "ua_1_2_1005"
    assert TREE.topic(Kind.STATUS, 1) == "opcua/uadp/status/1"
    assert TREE.topic(Kind.METADATA, 1, "group-2", "arm") == "opcua/uadp/metadata/1/group-2/arm"


@given(SOURCES, st.sampled_from(QUEUES))
def test_what_is_made_of_a_source_is_read_as_that_source(source: Topic, queue: str) -> None:
    tree = TopicTree("plant", queue)
    assert tree.read(tree.queue(source)) == Place(Kind.DATA, str(source.space), source)


@given(st.text())
def test_a_name_is_one_level_that_brokers_take(name: str) -> None:
    level = level_of(name)
    assert level
    assert level.isascii()
    assert not set(level) & set("/+# \0$")
    place = TREE.read(TREE.topic(Kind.METADATA, 1, "group-2", name))
    if len(level) < 900:
        assert place == Place(Kind.METADATA, "1", None, ("group-2", level))


@given(st.text(min_size=1), st.text(min_size=1))
def test_two_names_are_two_levels(one: str, other: str) -> None:
    readable = "\ud800" <= max(one + other) <= "\udfff"
    assert one == other or readable or level_of(one) != level_of(other)


@given(st.text() | st.from_regex(r"opcua/uadp/[a-z#+$/0-9-]*", fullmatch=True))
def test_any_topic_is_read_or_is_none(topic: str) -> None:
    place = TREE.read(topic)
    assert place is None or isinstance(place, Place)


@pytest.mark.parametrize(
    "topic",
    [
        "",
        "#",
        "+",
        "$SYS/broker/version",
        "ua_1_2_01005",
        "ua_1_2_1005/",
        "/ua_1_2_1005",
        "ua_1_2",
        "ua_240_2_5",
        "ua_1_0_5",
        "ua_1_2_1005\0",
        "ua_1_2_1005\n",
        "ua_\u0661_2_5",
        "opcua/uadp/data",
        "opcua/uadp/data/1",
        "opcua/uadp/status/1/2",
        "opcua/uadp/status/",
        "opcua/uadp/metadata/1//arm",
        "opcua/uadp/metadata/1/+/arm",
        "opcua/uadp/else/1",
        "opcua/json/data/1/group",
        "x" * 65_000,
        "opcua/uadp/status/" + "1" * 65_000,
    ],
)
def test_hostile_topics_are_none_of_ours(topic: str) -> None:
    assert TREE.read(topic) is None


def test_a_source_that_is_named_twice_is_the_same() -> None:
    tree = TopicTree("opcua", "{space}/{topic}")
    assert tree.read("1/ua_1_2_1005") == Place(Kind.DATA, "1", SOURCE)
    assert tree.read("2/ua_1_2_1005") is None


@pytest.mark.parametrize(
    ("prefix", "queue"),
    [
        ("", "{topic}"),
        ("#", "{topic}"),
        ("$SYS", "{topic}"),
        ("a b", "{topic}"),
        ("opcua", ""),
        ("opcua", "values"),
        ("opcua", "{space}/{ns}"),
        ("opcua", "{robot}/{topic}"),
        ("opcua", "{topic}/{topic}"),
        ("opcua", "{topic}/+"),
        ("opcua", "{topic"),
        ("opcua", "opcua/uadp/{topic}"),
    ],
)
def test_a_tree_that_cannot_be_one_is_refused(prefix: str, queue: str) -> None:
    with pytest.raises(TransportError):
        TopicTree(prefix, queue)


def test_requests_are_heard_by_their_responder_alone() -> None:
    assert "opcua/uadp/action-request/7/+" in TREE.filters(7)
    assert "opcua/uadp/action-request/+/+" in TREE.filters(None)
    assert "+" in TREE.filters(7)
    assert "hall2/+" in TopicTree("opcua", "hall2/{topic}").filters(7)


def matches(wanted: str, topic: str) -> bool:
    """Whether a topic is of a filter without `#` (MQTT 4.7)."""
    levels, found = wanted.split("/"), topic.split("/")
    return len(levels) == len(found) and all(level in ("+", its) for level, its in zip(levels, found, strict=True))


@pytest.mark.parametrize("tree", [TREE, TopicTree(is_json=True), TopicTree(is_json=True, has_actions=False)])
def test_each_topic_that_is_heard_is_of_one_filter(tree: TopicTree) -> None:
    base = "opcua/json" if tree.is_json else "opcua/uadp"
    tails = ("7", "7/group-2", "7/group-2/arm", "7/group-2/arm/more")
    topics = ["ua_1_2_1005", *(f"{base}/{kind.value}/{tail}" for kind in Kind for tail in tails)]
    for topic in topics:
        of_another = topic.startswith(f"{base}/action-request/7")
        count = sum(matches(wanted, topic) for wanted in tree.filters(1))
        assert count <= 1, topic
        if tree.read(topic) is not None:
            assert count == (0 if of_another else 1), topic
    assert not any("#" in wanted for wanted in tree.filters(1)), "to nats-server each is two"
    assert len(TREE.filters(1)) == 6


def test_a_response_goes_to_a_topic_of_responses_and_nowhere_else() -> None:
    assert TREE.answer("opcua/uadp/action-request/7/actions-2") == "opcua/uadp/action-response/7/actions-2"
    assert TREE.answer("ua_1_2_1005") is None
    assert TREE.response_topic("opcua/uadp/action-response/0/server") == "opcua/uadp/action-response/0/server"
    for elsewhere in ("ua_1_2_1005", "opcua/uadp/metadata/1/g/w", "opcua/uadp/action-response/+/x", "#", "door/open"):
        assert TREE.response_topic(elsewhere) is None
