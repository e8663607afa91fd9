from __future__ import annotations

from functools import partial

import pytest
from ua_bridges.ros.convert import compile_writer
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros2.outlet import MOST_HELD, HeldPublisher
from ua_bridges.ros2.qos import MIRROR, Qos

from tests.unit.bridges.ros2.fakes import FakeNode, Message, fake_type, publisher

KIND = fake_type("std_msgs/Int32")
FILL = compile_writer(KIND.schema, ("data",), lambda _native: Message())


def make(qos: Qos = MIRROR) -> HeldPublisher:
    return HeldPublisher("/ua_1_2_9", KIND, qos)


def unheeded() -> None:
    """Nobody asks whether a message has gone."""


def attend(outlet: HeldPublisher, node: FakeNode, now: float) -> bool:
    return outlet.attend(node.as_node(), now, 0.0, lambda _policy: None)


def test_first_messages_wait_until_the_subscribers_have_matched() -> None:
    outlet, node = make(), FakeNode()
    node.there = [publisher(b"s"), publisher(b"t")]
    for number in range(3):
        outlet.publish(outlet.filling(FILL), (number,), unheeded)
    node.publisher.matched = 1
    assert not attend(outlet, node, 10.0)
    assert node.publisher.sent == []
    node.publisher.matched = 2
    assert not attend(outlet, node, 10.005)
    assert node.publisher.sent == [0]
    node.publisher.acknowledged = False
    assert not attend(outlet, node, 10.01)
    node.publisher.acknowledged = True
    assert attend(outlet, node, 10.015)
    assert node.publisher.sent == [0, 1, 2]
    outlet.publish(outlet.filling(FILL), (3,), unheeded)
    assert node.publisher.sent == [0, 1, 2, 3]


def test_they_do_not_wait_for_ever() -> None:
    outlet, node = make(), FakeNode()
    node.there = [publisher(b"s")]
    outlet.publish(outlet.filling(FILL), (0,), unheeded)
    assert not attend(outlet, node, 10.0)
    assert attend(outlet, node, 11.0)
    assert node.publisher.sent == [0]


def test_messages_that_are_not_held_any_more_are_told() -> None:
    outlet, node = make(), FakeNode()
    lost = [outlet.publish(outlet.filling(FILL), (number,), unheeded) for number in range(MOST_HELD + 2)]
    assert lost == [0] * MOST_HELD + [1, 1]
    attend(outlet, node, 1.0)
    assert node.publisher.sent == [2]
    assert outlet.close(node.as_node()) == MOST_HELD - 1


def test_nobody_is_waited_for_where_nobody_can_match() -> None:
    outlet, node = make(Qos(reliable=True, transient_local=False, depth=10)), FakeNode()
    node.there = [publisher(b"s", transient_local=True), publisher(b"t", kind="std_msgs/msg/Float64")]
    assert attend(outlet, node, 10.0)
    assert outlet.is_open


def test_subscriber_that_acknowledges_nothing_gets_a_moment() -> None:
    outlet, node = make(), FakeNode()
    node.there, node.publisher.matched = [publisher(b"s", reliable=False)], 1
    outlet.publish(outlet.filling(FILL), (0,), unheeded)
    assert not attend(outlet, node, 10.0)
    assert node.publisher.sent == []
    assert not attend(outlet, node, 10.06)
    assert node.publisher.sent == [0]
    assert attend(outlet, node, 10.07)


def test_node_that_has_just_come_up_waits_for_what_it_has_not_heard_of() -> None:
    outlet, node = make(), FakeNode()
    outlet.publish(outlet.filling(FILL), (0,), unheeded)
    assert not attend(outlet, node, 0.1)
    node.there = [publisher(b"s")]
    assert not attend(outlet, node, 1.05)
    assert node.publisher.sent == []
    node.publisher.matched = 1
    assert not attend(outlet, node, 1.1)
    assert node.publisher.sent == [0]
    assert attend(outlet, node, 1.11)


@pytest.mark.parametrize("value", ["x", 1 << 31, None])
def test_value_that_does_not_fit_is_refused(value: object) -> None:
    outlet = make()
    with pytest.raises(ConversionError, match="field data"):
        outlet.publish(outlet.filling(FILL), (value,), unheeded)


def test_close_ends_the_publisher() -> None:
    outlet, node = make(), FakeNode()
    attend(outlet, node, 10.0)
    outlet.close(node.as_node())
    assert node.destroyed == 1
    assert not outlet.is_open


def test_a_message_has_gone_when_it_is_published_and_not_while_it_is_held() -> None:
    outlet, node, gone = make(), FakeNode(), list[int]()
    node.there = [publisher(b"s")]
    for number in range(2):
        outlet.publish(outlet.filling(FILL), (number,), partial(gone.append, number))
    assert gone == []
    node.publisher.matched = 1
    attend(outlet, node, 10.0)
    assert gone == [0]
    assert attend(outlet, node, 10.1)
    assert gone == [0, 1]
    outlet.publish(outlet.filling(FILL), (2,), partial(gone.append, 2))
    assert gone == [0, 1, 2]


def test_a_message_that_is_held_to_the_end_has_not_gone() -> None:
    outlet, node, gone = make(), FakeNode(), list[int]()
    outlet.publish(outlet.filling(FILL), (1,), partial(gone.append, 1))
    assert outlet.close(node.as_node()) == 1
    assert gone == []
