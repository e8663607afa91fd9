"""What of a broker may reach the subscriber: a message on the queue of one DataSetWriter."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tests.unit.transport.mqtt.speaking import Speaking
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.core import Heard
from ua_fleet.transport.mqtt.incoming import Verdict, judge
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.outline import read_outline

TREE = TopicTree()
SPACES = st.integers(0, 232) | st.integers(256, 65_535)
NUMBERS = st.integers(1, 65_535)
SOURCES = st.builds(Topic, SPACES, NUMBERS, NUMBERS)
BYTES = st.integers(0, 255)


def head(source: Topic, extended1: int = 0x01) -> bytes:
    """The beginning of a data message of a bridge."""
    space, ns, writer_id = (number.to_bytes(2, "little") for number in source)
    return bytes((0xF1, extended1)) + space + b"\x01" + ns + b"\x01" + writer_id


def by_outline(payload: bytes, source: Topic) -> Verdict:
    """What the outline of a message says, with which that of its first bytes has to agree."""
    try:
        outline = read_outline(Cursor(payload))
    except RemoteWireError:
        return Verdict.FRESH  # it is counted where it is decoded
    is_data = not outline.is_discovery and not outline.is_action
    named = outline.publisher_id, outline.publisher_id_type, outline.writer_group_id, outline.writer_ids
    wanted = source.space, PublisherIdType.UINT16, source.ns, (source.id,)
    return Verdict.FRESH if is_data and named == wanted else Verdict.NOT_ITS_TOPIC


@given(SOURCES, st.sampled_from([0x01, 0x11]), st.binary(max_size=12))
def test_a_message_of_its_writer_is_let_in_whatever_follows_on_its_head(
    source: Topic, extended1: int, rest: bytes
) -> None:
    payload = head(source, extended1) + rest
    assert judge(TREE, TREE.queue(source), payload, is_retained=False) is Verdict.FRESH
    assert judge(TREE, TREE.queue(source), payload, is_retained=True) is Verdict.KEPT
    assert by_outline(payload, source) is Verdict.FRESH


@given(SOURCES, st.sampled_from([0x01, 0x11]), st.integers(0, 9), BYTES, st.binary(max_size=12))
def test_one_byte_of_the_head_changes_what_is_let_in_as_the_outline_says(
    source: Topic, extended1: int, place: int, byte: int, rest: bytes
) -> None:
    payload = bytearray(head(source, extended1) + rest)
    payload[place] = byte
    assert judge(TREE, TREE.queue(source), bytes(payload), is_retained=False) is by_outline(bytes(payload), source)


@given(SOURCES, SOURCES)
def test_a_message_of_another_writer_is_not_let_in(source: Topic, other: Topic) -> None:
    wanted = Verdict.FRESH if source == other else Verdict.NOT_ITS_TOPIC
    assert judge(TREE, TREE.queue(source), head(other), is_retained=False) is wanted


def test_a_space_with_a_publisher_id_of_its_own_is_known_by_that() -> None:
    ids = PublisherIds({1: (PublisherIdType.STRING.value, "cell")})
    tree, source = TopicTree(publisher_ids=ids), Topic(1, 2, 1005)
    own = ids.outward(head(source))
    assert judge(tree, tree.queue(source), own, is_retained=False) is Verdict.FRESH
    assert judge(tree, tree.queue(source), head(Topic(1, 2, 1006)), is_retained=False) is Verdict.NOT_ITS_TOPIC


def test_what_a_topic_says_is_read_once_and_that_of_a_long_one_each_time() -> None:
    tree = TopicTree()
    assert tree.read("ua_1_2_1005") is tree.read("ua_1_2_1005")
    long = "opcua/uadp/metadata/1/group-2/" + "x" * 200
    assert tree.read(long) == tree.read(long)
    assert tree.read(long) is not tree.read(long)  # strangers could have it remember megabytes


@given(SOURCES, st.lists(st.tuples(st.integers(0, 9), BYTES), max_size=1), st.binary(max_size=12))
def test_a_message_that_is_usual_is_handed_on_as_it_is(
    source: Topic, changed: list[tuple[int, int]], rest: bytes
) -> None:
    core = Speaking().core
    topic, payload = TREE.queue(source), bytearray(head(source) + rest)
    for place, byte in changed:
        payload[place] = byte
    assert not core.is_usual(topic, bytes(payload)), "nothing is known of a topic on which nothing came"
    core.received(topic, head(source), 0.0, is_retained=False)
    if core.is_usual(topic, bytes(payload)):
        assert core.received(topic, bytes(payload), 0.0, is_retained=False) == [Heard(bytes(payload), True)]
    else:
        assert changed
    assert not core.is_usual(TREE.queue(source._replace(id=source.id % 65_535 + 1)), bytes(payload))


def test_nothing_is_usual_where_a_queue_does_not_say_the_publisher() -> None:
    ids = PublisherIds({1: (PublisherIdType.STRING.value, "cell")})
    core, source = Speaking(publisher_ids=ids).core, Topic(1, 2, 1005)
    own = ids.outward(head(source))
    assert core.received(TREE.queue(source), own, 0.0, is_retained=False) == [Heard(own, True)]
    assert not core.is_usual(TREE.queue(source), own)
