"""What a process says and hears over a broker, without a broker: a publisher, its envelope, and the core."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.publishing import FIELDS, TOPIC, WALL
from tests.unit.pubsub.security.securing import action, announcement, data, envelope, group_keys, probe
from tests.unit.transport.mqtt.speaking import Speaking
from ua_fleet.counters import Drop
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.core import STRANGER_GRACE_S, Heard, MqttCore
from ua_fleet.transport.mqtt.incoming import Verdict
from ua_fleet.transport.mqtt.outbox import KEPT_FOR_S, Outbox
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.transport.party import Party
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire import Codec, SecurityMode, encode_action, read_security
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ActionTarget, PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import PublisherIdType


def test_a_publisher_has_its_announcements_retained_each_at_its_topic() -> None:
    sent = Speaking().begin()
    retained = {each.topic for each in sent if each.is_retained}
    assert retained == {
        "opcua/uadp/application/1",
        "opcua/uadp/status/1",
        "opcua/uadp/connection/1",
        "opcua/uadp/action-responder/1",
        "opcua/uadp/metadata/1/group-2/arm",
    }
    assert all(each.qos == 1 and each.expiry_s == KEPT_FOR_S for each in sent if each.is_retained)
    assert {each.topic for each in sent if not each.is_retained} == {"ua_1_2_1001"}


def test_metadata_goes_before_the_first_value() -> None:
    speaking = Speaking()
    speaking.core.connected(speaking.now)
    speaking.send(speaking.publisher.announce(TOPIC, "arm", FIELDS, now=speaking.now, wall_ticks=WALL))
    speaking.send(speaking.publisher.publish(TOPIC, (1.0, "a"), timestamp=WALL, now=speaking.now))
    topics = [each.topic for each in speaking.taken()]
    assert topics == ["opcua/uadp/metadata/1/group-2/arm", "ua_1_2_1001", "ua_1_2_1001"]


def test_the_status_over_a_broker_is_not_cyclic_and_the_will_is_its_end() -> None:
    speaking = Speaking()
    (status,) = [each for each in speaking.begin() if each.topic.endswith("status/1")]
    decoded, will = Codec().decode(status.payload), Codec().decode(speaking.core.will(0.0) or b"")
    assert isinstance(decoded, StatusAnnouncement)
    assert isinstance(will, StatusAnnouncement)
    assert (decoded.is_cyclic, decoded.state) == (False, PubSubState.OPERATIONAL)
    assert (will.is_cyclic, will.state) == (False, PubSubState.ERROR)
    speaking.now += 100.0
    later = [Codec().decode(datagram) for datagram in speaking.publisher.poll(speaking.now)]
    assert not any(isinstance(each, StatusAnnouncement) for each in later)
    speaking.send(speaking.publisher.end())
    (last,) = [each for each in speaking.taken() if each.topic.endswith("status/1")]
    ended = Codec().decode(last.payload)
    assert isinstance(ended, StatusAnnouncement)
    assert (ended.is_cyclic, ended.state) == (False, PubSubState.DISABLED)


def test_each_source_has_its_topic_and_shares_no_message_with_others() -> None:
    speaking = Speaking()
    speaking.begin()
    other = Topic(1, 2, 1002)
    speaking.send(speaking.publisher.announce(other, "hand", FIELDS, now=speaking.now, wall_ticks=WALL))
    speaking.taken()
    speaking.now += 1.5
    speaking.send(speaking.publisher.poll(speaking.now))
    keep_alives = [each for each in speaking.taken() if not each.is_retained]
    assert {each.topic for each in keep_alives} == {"ua_1_2_1001", "ua_1_2_1002"}
    assert {each.expiry_s for each in keep_alives} == {3}, "one that is older says nothing of now"


def test_two_sources_of_one_name_have_two_topics() -> None:
    speaking = Speaking()
    speaking.begin()
    speaking.send(speaking.publisher.announce(Topic(1, 2, 1002), "arm", FIELDS, now=speaking.now, wall_ticks=WALL))
    assert "opcua/uadp/metadata/1/group-2/arm-1002" in {each.topic for each in speaking.taken()}


def test_a_source_that_gets_another_name_or_goes_is_cleared_at_the_broker() -> None:
    speaking = Speaking()
    speaking.begin()
    speaking.now += 1.0
    speaking.send(speaking.publisher.announce(TOPIC, "leg", FIELDS, now=speaking.now, wall_ticks=WALL))
    sent = {each.topic: each.payload for each in speaking.taken()}
    assert sent["opcua/uadp/metadata/1/group-2/arm"] == b""
    assert sent["opcua/uadp/metadata/1/group-2/leg"]
    speaking.publisher.retire(TOPIC)
    speaking.core.poll(speaking.now)
    (cleared,) = speaking.taken()
    assert (cleared.topic, cleared.payload, cleared.is_retained) == ("opcua/uadp/metadata/1/group-2/leg", b"", True)


@pytest.mark.parametrize("mode", [SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT])
def test_under_a_new_key_everything_that_is_retained_goes_again_first(mode: SecurityMode) -> None:
    speaking = Speaking(mode=mode)
    first = {each.topic: read_security(each.payload).token_id for each in speaking.begin() if each.is_retained}
    assert set(first.values()) == {2}, "at 100 s the second key of 60 s is in use"
    speaking.now = 125.0
    speaking.send(speaking.publisher.publish(TOPIC, (1.0, "a"), timestamp=WALL, now=speaking.now))
    sent = speaking.taken()
    assert [each.is_retained for each in sent] == [True] * len(first) + [False]
    assert {read_security(each.payload).token_id for each in sent} == {3}
    assert {each.topic for each in sent if each.is_retained} == set(first)


@pytest.mark.parametrize("mode", [SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT])
def test_who_hears_a_publisher_first_takes_what_has_waited_for_the_broker_too(mode: SecurityMode) -> None:
    """A server that was started anew, and hears by what is kept of a publisher whose values are from before."""
    speaking = Speaking(mode=mode)
    speaking.core.connected(speaking.now)
    speaking.send(speaking.publisher.announce(TOPIC, "arm", FIELDS, now=speaking.now, wall_ticks=WALL))
    (flying, *_) = list(speaking.core.take(speaking.now))
    speaking.core.acknowledged(flying.parcel)
    speaking.core.disconnected()
    for number in (1.0, 2.0):
        speaking.send(speaking.publisher.publish(TOPIC, (number, "a"), timestamp=WALL, now=speaking.now))
    speaking.core.connected(speaking.now)
    first = list(speaking.core.take(speaking.now))
    values = [each.payload for each in first if each.topic == TOPIC.name]
    listener, group = envelope(0, mode=mode), telemetry_group(1)
    listener.want(group)
    listener.install(group, group_keys(2, seed=f"0{group}"), speaking.now)
    assert all(listener.open(each.payload, speaking.now) for each in first if each.payload)
    assert len(values) == 2
    # The broker may have had them: who takes them now knows them by their numbers.
    speaking.core.disconnected()
    speaking.core.connected(speaking.now)
    assert [each.payload for each in speaking.core.take(speaking.now) if each.topic == TOPIC.name] == values


def test_without_a_key_there_is_no_will_and_nothing_is_sent_unsecured() -> None:
    speaking = Speaking(mode=SecurityMode.SIGN_AND_ENCRYPT)
    speaking.envelope = envelope(1, mode=SecurityMode.SIGN_AND_ENCRYPT)
    core = MqttCore(
        Party(
            publisher_id=1,
            seal=speaking.envelope.seal,
            token=speaking.envelope.sending_token,
            is_secured=True,
            names_of=speaking.publisher.names_of,
            receive_kept=lambda _datagram, _sender: None,
        ),
        TopicTree(),
        Outbox(),
    )
    assert core.will(0.0) is None
    assert speaking.envelope.problem == "", "the server asks for its will before it has made its keys"
    speaking.envelope.install(telemetry_group(1), group_keys(seed="k"), 0.0)
    will = core.will(0.0)
    assert will is not None
    assert read_security(will).mode is SecurityMode.SIGN_AND_ENCRYPT


def request(timeout_ms: float, age_s: float) -> bytes:
    return encode_action(
        ActionMessage(
            1,
            2,
            1003,
            1,
            1,
            ActionState.EXECUTING,
            is_request=True,
            requestor_id="0.1",
            correlation_data=b"0123456789abcdef",
            timeout_hint_ms=timeout_ms,
            timestamp=WALL - round(age_s * TICKS_PER_SECOND),
        )
    )


def test_a_request_expires_at_the_broker_with_its_timeout_and_is_not_sent_after_it() -> None:
    speaking = Speaking()
    speaking.core.connected(speaking.now)
    speaking.send([request(2500.0, 0.0)])
    (sent,) = speaking.taken()
    assert (sent.topic, sent.qos, sent.is_retained, sent.expiry_s) == (
        "opcua/uadp/action-request/1/actions-2",
        1,
        False,
        3,
    )
    speaking.send([request(2500.0, 2.6)])
    assert speaking.taken() == []
    assert speaking.core.take_drops() == {Drop.EXPIRED: 1}


def test_a_response_goes_to_the_topic_of_its_request_or_to_the_one_that_is_wanted() -> None:
    speaking = Speaking()
    speaking.core.connected(speaking.now)
    sender = ("opcua/uadp/action-request/1/actions-2", 0)
    response = encode_action(
        ActionMessage(1, 2, 1003, 1, 1, ActionState.DONE, is_request=False, requestor_id="0.1", status=0)
    )
    default = speaking.core.answer_address(None, sender)
    wanted = speaking.core.answer_address("opcua/uadp/action-response/0/server", sender)
    for address in (default, wanted):
        speaking.send([response], address)
    assert [each.topic for each in speaking.taken()] == [
        "opcua/uadp/action-response/1/actions-2",
        "opcua/uadp/action-response/0/server",
    ]
    assert speaking.core.answer_address("ua_1_2_1005", sender) is None
    assert speaking.core.answer_address(None, ("ua_1_2_1005", 0)) is None


def test_setpoints_are_commands_of_quality_0() -> None:
    speaking = Speaking()
    setpoint = data("x", publisher_id=0, writer_group_id=77)
    speaking.send([setpoint])
    assert speaking.core.take_drops() == {Drop.BROKER_AWAY: 1}
    speaking.core.connected(speaking.now)
    speaking.send([setpoint])
    (sent,) = speaking.taken()
    assert (sent.topic, sent.qos, sent.expiry_s) == ("ua_0_77_1001", 0, 1)


def test_probes_and_what_only_answers_them_have_topics_of_their_own() -> None:
    speaking = Speaking()
    speaking.begin()
    speaking.send([probe(7), announcement(1)])
    assert [(each.topic, each.is_retained) for each in speaking.taken()] == [
        ("opcua/uadp/probe/7", False),
        ("opcua/uadp/metadata/1/group-2/arm", True),
    ]
    speaking.publisher.retire(TOPIC)
    speaking.send([announcement(1)])
    assert [(each.topic, each.is_retained) for each in speaking.taken()] == [("opcua/uadp/answer/1", False)]


def test_actions_are_announced_at_topics_of_their_own() -> None:
    speaking = Speaking()
    speaking.begin()
    topic = Topic(1, 2, 1003)
    fields = FIELDS[:1]
    speaking.send(
        speaking.publisher.announce_action(
            topic, "pick", (ActionTarget(1, "pick"),), fields, fields, now=speaking.now, wall_ticks=WALL
        )
    )
    assert "opcua/uadp/action-metadata/1/actions-2/pick" in {each.topic for each in speaking.taken()}


HEARD = [
    ("ua_1_2_1001", data(), Verdict.FRESH),
    ("opcua/uadp/data/1/any", data(), Verdict.FRESH),
    ("opcua/uadp/data/1/any/name", data(), Verdict.FRESH),
    ("ua_2_2_1001", data(), None),
    ("ua_1_2_1002", data(), None),
    ("ua_1_3_1001", data(), None),
    ("opcua/uadp/data/2/any", data(), None),
    ("opcua/uadp/metadata/1/g/w", data(), None),
    ("opcua/uadp/status/1", data(), None),
    ("opcua/uadp/metadata/1/g/w", announcement(), Verdict.FRESH),
    ("opcua/uadp/metadata/2/g/w", announcement(), None),
    ("ua_1_2_1001", announcement(), None),
    ("opcua/uadp/probe/1", announcement(), None),
    ("opcua/uadp/probe/1", probe(), Verdict.FRESH),
    ("opcua/uadp/answer/1", probe(), None),
    ("opcua/uadp/action-request/1/g", action(), Verdict.FRESH),
    ("opcua/uadp/action-request/2/g", action(), None),
    ("ua_1_2_1001", action(), None),
    ("some/other/topic", data(), None),
    ("$SYS/broker/uptime", b"12 seconds", None),
    ("ua_1_2_1001", b"rubbish", Verdict.FRESH),
    ("ua_1_2_1001", b"", None),
]


def expected_of(payload: bytes, verdict: Verdict | None) -> list[Heard]:
    return [] if verdict is None else [Heard(payload, verdict is Verdict.FRESH)]


@pytest.mark.parametrize(("topic", "payload", "verdict"), HEARD)
def test_a_message_has_to_be_what_its_topic_says(topic: str, payload: bytes, verdict: Verdict | None) -> None:
    core = Speaking().core
    assert core.received(topic, payload, 0.0, is_retained=False) == expected_of(payload, verdict)
    expected = {Drop.NOT_ITS_TOPIC: 1} if verdict is None and payload else {}
    assert core.take_drops() == expected
    if verdict is not None:
        assert core.received(topic, payload, 0.0, is_retained=True) == [Heard(payload, is_fresh=False)]


def test_a_status_is_never_fresh_as_it_may_be_a_will() -> None:
    speaking = Speaking()
    will = speaking.core.will(0.0) or b""
    assert speaking.core.received("opcua/uadp/status/1", will, 0.0, is_retained=False) == [Heard(will, is_fresh=False)]


def test_another_status_in_our_name_is_replaced_by_ours() -> None:
    speaking = Speaking()
    speaking.begin()
    will = speaking.core.will(0.0) or b""
    for _ in range(3):
        speaking.core.received("opcua/uadp/status/1", will, speaking.now, is_retained=False)
    (again,) = speaking.taken()
    decoded = Codec().decode(again.payload)
    assert isinstance(decoded, StatusAnnouncement)
    assert decoded.state == PubSubState.OPERATIONAL


def test_what_an_earlier_life_left_at_the_broker_is_cleared_unless_it_is_announced_again() -> None:
    speaking = Speaking()
    speaking.begin()
    old, again = "opcua/uadp/metadata/1/group-2/old", "opcua/uadp/metadata/1/group-2/hand"
    for topic in (old, again, "opcua/uadp/metadata/2/group-2/other"):
        speaking.core.received(topic, announcement(int(topic.split("/")[3])), speaking.now, is_retained=True)
    speaking.send(speaking.publisher.announce(Topic(1, 2, 1002), "hand", FIELDS, now=speaking.now, wall_ticks=WALL))
    speaking.taken()
    speaking.now += STRANGER_GRACE_S
    speaking.core.poll(speaking.now)
    assert [(each.topic, each.payload) for each in speaking.taken()] == [(old, b"")]


def test_large_metadata_that_goes_in_chunks_is_not_retained_as_its_last_chunk() -> None:
    speaking = Speaking()
    speaking.begin()
    small = envelope(1, mode=SecurityMode.NONE, max_datagram_bytes=300)
    speaking.envelope = small
    many = tuple(FIELDS[0]._replace(name=f"field{number}") for number in range(20))
    datagrams = speaking.publisher.announce(Topic(1, 2, 1004), "many", many, now=speaking.now, wall_ticks=WALL)
    speaking.send(datagrams[:1])
    sent = speaking.taken()
    assert len(sent) > 1
    assert not any(each.is_retained for each in sent)


@pytest.mark.parametrize("mode", [SecurityMode.NONE, SecurityMode.SIGN_AND_ENCRYPT])
def test_a_publisher_with_another_publisher_id_has_it_in_its_topics_and_is_heard(mode: SecurityMode) -> None:
    ids = PublisherIds({1: (PublisherIdType.STRING.value, "hall/1")})
    one, other = Speaking(mode=mode, publisher_ids=ids), Speaking(mode=mode, publisher_ids=ids).core
    sent = one.begin()
    one.send(one.publisher.publish(TOPIC, (1.0, "a"), timestamp=WALL, now=one.now))
    sent += one.taken()
    topics = [each.topic for each in sent]
    assert {"opcua/uadp/status/hall%2F1", "opcua/uadp/metadata/hall%2F1/group-2/arm", TOPIC.name} <= set(topics)
    for each in sent:
        assert [heard.datagram for heard in other.received(each.topic, each.payload, 1.0, is_retained=False)] == [
            each.payload
        ], each.topic
    (value,) = [each.payload for each in sent if each.topic == TOPIC.name][-1:]
    assert other.received("ua_2_2_1001", value, 1.0, is_retained=False) == []
    assert other.received("ua_1_2_1002", value, 1.0, is_retained=False) == []
    assert other.take_drops() == {Drop.NOT_ITS_TOPIC: 2}
    assert "opcua/uadp/action-request/hall%2F1/+" in one.core.filters


def test_a_status_that_is_not_ours_is_replaced_under_another_publisher_id_too() -> None:
    one = Speaking(publisher_ids=PublisherIds({1: (PublisherIdType.STRING.value, "hall/1")}))
    one.begin()
    one.core.received(one.core.status_topic or "", one.core.will(0.0) or b"", one.now, is_retained=False)
    assert [each.topic for each in one.taken()] == [one.core.status_topic]
