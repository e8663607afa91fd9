from __future__ import annotations

import itertools

import pytest
from ua_bridges.ros.topic_mapping import QosConfig
from ua_bridges.ros2.qos import EVENTS, MIRROR, QUEUE_DEPTH, Offer, Qos, choose, is_outdated, sink_qos

A, B = b"a", b"b"


def offers(*pairs: tuple[bool, bool]) -> list[Offer]:
    return [Offer(bytes([number]), *pair) for number, pair in enumerate(pairs)]


@pytest.mark.parametrize(
    ("present", "reliable", "transient_local"),
    [
        ([(True, True)], True, True),
        ([(True, False)], True, False),
        ([(False, True)], False, True),
        ([(False, False)], False, False),
        ([(True, True), (False, True)], False, True),
        ([(True, True), (True, False)], True, False),
        ([(True, False), (False, True)], False, False),
        ([], True, False),
    ],
)
def test_subscription_asks_for_what_all_publishers_offer(
    present: list[tuple[bool, bool]], reliable: bool, transient_local: bool
) -> None:
    assert choose(offers(*present)) == Qos(reliable, transient_local, QUEUE_DEPTH)


@pytest.mark.parametrize("pair", list(itertools.product([True, False], repeat=2)))
def test_configured_keys_overrule_the_publishers(pair: tuple[bool, bool]) -> None:
    configured = QosConfig(reliability="best_effort", durability="transient_local", depth=3)
    assert choose(offers(pair), configured) == Qos(False, True, 3)
    assert choose(offers(pair), QosConfig(depth=3)) == Qos(*pair, 3)


@pytest.mark.parametrize(
    ("current", "wanted", "made_for", "present", "outdated"),
    [
        (Qos(True, True, 1), Qos(True, True, 1), {A}, {B}, False),
        (Qos(True, False, 1), Qos(False, False, 1), {A}, {A, B}, True),  # a publisher offers less
        (Qos(True, True, 1), Qos(True, False, 1), {A}, {A, B}, True),
        (Qos(True, False, 1), Qos(True, True, 1), {A, B}, {B}, True),  # history can be had now
        (
            Qos(False, False, 1),
            Qos(True, False, 1),
            {A, B},
            {B},
            False,
        ),  # nothing is gained for the publisher that is left
        (Qos(False, False, 1), Qos(True, False, 1), {A}, {B}, True),  # all are new
    ],
)
def test_when_a_subscription_is_made_again(
    current: Qos, wanted: Qos, made_for: set[bytes], present: set[bytes], outdated: bool
) -> None:
    assert is_outdated(current, wanted, made_for, present) is outdated


def test_every_subscriber_matches_a_mirrored_topic() -> None:
    assert (MIRROR.reliable, MIRROR.transient_local, MIRROR.depth) == (True, True, 1)


def test_events_are_kept_for_who_is_there_and_for_nobody_else() -> None:
    assert Qos(reliable=True, transient_local=False, depth=QUEUE_DEPTH) == EVENTS


def test_sink_offers_rclpys_default_unless_configured() -> None:
    assert sink_qos(QosConfig()) == Qos(True, False, 10)
    assert sink_qos(QosConfig(reliability="best_effort", durability="transient_local", depth=1)) == Qos(False, True, 1)
