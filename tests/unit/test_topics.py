from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import LoopVerdict, Side, Topic, check_ros2_space, check_space, loop_verdict

SPACES = st.one_of(st.integers(0, 232), st.integers(256, 65_535))
NUMBERS = st.integers(1, 65_535)


@given(SPACES, NUMBERS, NUMBERS)
def test_every_triple_has_one_name_and_comes_back_from_it(space: int, ns: int, id: int) -> None:
    topic = Topic.checked(space, ns, id)
    assert topic.name == f"ua_{space}_{ns}_{id}"
    assert Topic.parse(topic.name) == topic
    assert tuple(topic) == (space, ns, id)


@given(st.text(alphabet="ua_0123456789/- ٣", max_size=20))
def test_a_name_is_either_refused_or_the_only_spelling_of_its_topic(name: str) -> None:
    try:
        topic = Topic.parse(name)
    except TopicInvalid:
        return
    assert topic.name == name


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("ua_1_2", "expected ua_"),
        ("ua_1_2_3_4", "expected ua_"),
        ("/ua_1_2_3", "expected ua_"),
        ("ua_1_2_3\n", "expected ua_"),
        ("UA_1_2_3", "expected ua_"),
        ("ua_01_2_3", "expected ua_"),
        ("ua_1_2_003", "expected ua_"),
        ("ua_1_2_-3", "expected ua_"),
        ("ua_1_2_٣", "expected ua_"),
        ("ua_1_2_123456", "expected ua_"),
        ("ua_1_0_3", "a namespace index is 1..65535"),
        ("ua_1_2_0", "an? identifier is 1..65535"),
        ("ua_1_2_65536", "an? identifier is 1..65535"),
        ("ua_1_65536_1", "a namespace index is 1..65535"),
        ("ua_233_2_3", "233..255 are reserved"),
        ("ua_255_2_3", "233..255 are reserved"),
        ("ua_65536_2_3", "a space id is 0..65535"),
        ("", "expected ua_"),
    ],
)
def test_illegal_names(name: str, reason: str) -> None:
    with pytest.raises(TopicInvalid, match=reason) as caught:
        Topic.parse(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("space", [0, 1, 2, 232, 256, 65_535])
def test_legal_spaces(space: int) -> None:
    assert check_space(space) == space


@pytest.mark.parametrize("space", [-1, 233, 255, 65_536])
def test_illegal_spaces(space: int) -> None:
    with pytest.raises(TopicInvalid):
        check_space(space)


@pytest.mark.parametrize("domain", [2, 101, 232])
def test_ros2_domains(domain: int) -> None:
    assert check_ros2_space(domain) == domain


@pytest.mark.parametrize("domain", [-1, 0, 1, 233, 256])
def test_numbers_that_no_ros_library_may_see(domain: int) -> None:
    with pytest.raises(TopicInvalid, match=r"2\.\.232"):
        check_ros2_space(domain)


@pytest.mark.parametrize(
    ("side", "origin", "own_publication", "verdict"),
    [
        (Side.PUBSUB, 1, False, LoopVerdict.DROP_LOOP),
        (Side.PUBSUB, 1, True, LoopVerdict.DROP_LOOP),
        (Side.PUBSUB, 0, False, LoopVerdict.TO_SPACE),
        (Side.PUBSUB, 2, False, LoopVerdict.TO_SPACE),
        (Side.PUBSUB, 2, True, LoopVerdict.TO_SPACE),
        (Side.SPACE, 1, False, LoopVerdict.TO_PUBSUB),
        (Side.SPACE, 1, True, LoopVerdict.DROP_OWN),
        (Side.SPACE, 0, False, LoopVerdict.DROP_FOREIGN),
        (Side.SPACE, 2, False, LoopVerdict.DROP_FOREIGN),
        (Side.SPACE, 2, True, LoopVerdict.DROP_FOREIGN),
    ],
)
def test_loop_rule_of_a_bridge_in_space_1(side: Side, origin: int, own_publication: bool, verdict: LoopVerdict) -> None:
    assert loop_verdict(side, origin, 1, own_publication) is verdict


@given(SPACES, SPACES, st.booleans())
def test_whatever_passes_one_side_is_dropped_on_the_other(origin: int, own: int, own_publication: bool) -> None:
    to_space = loop_verdict(Side.PUBSUB, origin, own, own_publication) is LoopVerdict.TO_SPACE
    to_pubsub = loop_verdict(Side.SPACE, origin, own, own_publication) is LoopVerdict.TO_PUBSUB
    assert not (to_space and to_pubsub)
