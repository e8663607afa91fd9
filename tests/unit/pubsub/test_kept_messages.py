"""What a broker has kept: it is verified, and says nothing of now. A will ends Good, and begins nothing."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Writing, only
from tests.unit.pubsub.security.securing import action, announcement, data, envelope, group_keys, one, probe
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import (
    DataReceived,
    PubSubTiming,
    SourceReturned,
    SourceSilent,
    Subscriber,
)
from ua_fleet.pubsub.events import AnnouncementReceived
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.wire import SecurityMode, encode_announcement
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget, PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, PublisherIdType

UINT16 = PublisherIdType.UINT16.value
MODES = [SecurityMode.NONE, SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT]


def status(state: PubSubState, publisher_id: int = 1) -> bytes:
    return encode_announcement(StatusAnnouncement(publisher_id, UINT16, 0, False, state))


class Both:
    """A bridge of space 1 and a reader in space 0, with their keys."""

    def __init__(self, mode: SecurityMode) -> None:
        groups = [] if mode is SecurityMode.NONE else [telemetry_group(1)]
        self.writing = Writing()
        self.sealing = envelope(1, *groups, mode=mode)
        self.counters = Counters()
        self.opening = envelope(0, *groups, mode=mode, counters=self.counters)
        self.subscriber = Subscriber(0, PubSubTiming(), self.counters, CODEC, envelope=self.opening)
        self.now = 0.0

    def sealed(self, plain: bytes) -> bytes:
        return one(self.sealing.seal(plain, self.now))

    def hear(self, datagram: bytes, *, is_fresh: bool = True) -> list[object]:
        return list(self.subscriber.receive(datagram, self.now, is_fresh=is_fresh))

    def hear_value(self) -> list[bytes]:
        """Have the reader know one Good value; the datagrams of it."""
        plain = [*self.writing.announce(), *self.writing.publish(1.0)]
        datagrams = [self.sealed(datagram) for datagram in plain]
        events = [event for datagram in datagrams for event in self.subscriber.receive(datagram, self.now)]
        assert len(only(DataReceived, events)) == 1
        return datagrams


@pytest.mark.parametrize("mode", MODES)
def test_kept_metadata_counts_and_neither_needs_nor_uses_its_nonce(mode: SecurityMode) -> None:
    both = Both(mode)
    metadata, *_ = both.writing.announce()
    kept = both.sealed(metadata)
    for _ in range(3):  # at each connection it comes again
        assert both.hear(kept, is_fresh=False) == []
    assert both.hear(kept) == []
    assert both.counters.drops == {}, "its nonce was not used by what was kept"
    events = both.subscriber.receive(both.sealed(both.writing.publish(1.0)[0]), 0.0)
    assert len(only(DataReceived, events)) == 1
    both.hear(kept)
    assert both.counters.drops == ({} if mode is SecurityMode.NONE else {Drop.REPLAYED: 1})


@pytest.mark.parametrize("mode", MODES)
def test_kept_metadata_comes_also_after_it_was_heard_fresh(mode: SecurityMode) -> None:
    both = Both(mode)
    metadata, *_ = both.hear_value()
    both.hear(metadata, is_fresh=False)
    assert both.counters.drops == {}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("plain", [data(), action(), probe()])
def test_kept_data_actions_and_probes_are_dropped_and_counted(mode: SecurityMode, plain: bytes) -> None:
    both = Both(mode)
    datagram = plain if mode is SecurityMode.NONE or plain != data() else both.sealed(plain)
    assert both.hear(datagram, is_fresh=False) == []
    assert both.counters.drops == {Drop.RETAINED: 1}


def test_kept_metadata_of_an_earlier_version_changes_nothing() -> None:
    both = Both(SecurityMode.SIGN)
    old = both.sealed(announcement(version=1))
    both.hear(both.sealed(announcement(version=5)))
    both.hear(old, is_fresh=False)
    assert both.counters.drops == {Drop.RETAINED: 1}
    both.hear(both.sealed(announcement(version=5)), is_fresh=False)
    both.hear(both.sealed(announcement(version=6)), is_fresh=False)
    assert both.counters.drops == {Drop.RETAINED: 1}


def skill(version: int) -> bytes:
    metadata = DataSetMetaData("pick", FIELDS, ConfigurationVersion(version, version))
    return encode_announcement(
        ActionMetaDataAnnouncement(1, UINT16, 0, 1003, (ActionTarget(1, "pick"),), metadata, metadata)
    )


def test_a_kept_action_of_an_earlier_version_is_not_asked_for() -> None:
    both = Both(SecurityMode.SIGN)
    old = both.sealed(skill(1))
    assert only(AnnouncementReceived, both.subscriber.receive(both.sealed(skill(5)), 0.0))
    assert both.hear(old, is_fresh=False) == []
    assert both.counters.drops == {Drop.RETAINED: 1}
    assert only(AnnouncementReceived, both.subscriber.receive(both.sealed(skill(6)), 0.0, is_fresh=False))


@pytest.mark.parametrize("mode", MODES[1:])
def test_what_is_kept_has_to_be_signed_by_its_publisher(mode: SecurityMode) -> None:
    both = Both(mode)
    forger = envelope(1, telemetry_group(1), mode=mode, seed="other")
    assert both.hear(one(forger.seal(announcement(), 0.0)), is_fresh=False) == []
    assert both.hear(announcement(), is_fresh=False) == []
    assert both.counters.drops == {Drop.BAD_SIGNATURE: 1, Drop.NOT_SECURED: 1}


@pytest.mark.parametrize("mode", MODES)
def test_a_will_ends_good_at_once_and_a_status_begins_nothing(mode: SecurityMode) -> None:
    both = Both(mode)
    will = both.sealed(status(PubSubState.ERROR))
    both.hear_value()
    both.now = 0.5
    silent = only(SourceSilent, both.subscriber.receive(will, both.now, is_fresh=False))
    assert [event.topic for event in silent] == [TOPIC]
    assert only(SourceSilent, both.subscriber.receive(will, both.now, is_fresh=False)) == []
    operational = both.sealed(status(PubSubState.OPERATIONAL))
    events = both.subscriber.receive(operational, both.now, is_fresh=False)
    assert only(SourceReturned, events) == []
    assert both.subscriber.poll(10.0) == [], "it is silent already"


def test_a_will_that_is_heard_again_is_undone_by_the_next_value() -> None:
    both = Both(SecurityMode.SIGN_AND_ENCRYPT)
    will = both.sealed(status(PubSubState.ERROR))
    both.hear_value()
    both.hear(will, is_fresh=False)
    value = both.sealed(both.writing.publish(2.0, timestamp=WALL + 1)[0])
    events = both.subscriber.receive(value, 0.6)
    assert [event.topic for event in only(SourceReturned, events)] == [TOPIC]
    assert only(SourceSilent, both.subscriber.poll(3.5)) == []
    assert [event.topic for event in only(SourceSilent, both.subscriber.poll(3.7))] == [TOPIC]


def test_a_will_whose_key_is_over_says_nothing() -> None:
    both = Both(SecurityMode.SIGN)
    will = both.sealed(status(PubSubState.ERROR))
    both.now = 170.0  # keys of 60 s, one past key
    both.hear_value()
    assert only(SourceSilent, both.subscriber.receive(will, both.now, is_fresh=False)) == []
    assert both.counters.drops[Drop.RETAINED] == 1


def test_a_will_ends_the_sources_of_its_publisher_alone() -> None:
    both = Both(SecurityMode.NONE)
    both.hear_value()
    assert only(SourceSilent, both.subscriber.receive(status(PubSubState.ERROR, 2), 0.1, is_fresh=False)) == []


def test_a_kept_chunk_joins_no_message() -> None:
    both = Both(SecurityMode.NONE)
    sealing = envelope(1, mode=SecurityMode.NONE, max_datagram_bytes=60)
    first, *_ = sealing.seal(announcement(), 0.0)
    assert both.hear(first, is_fresh=False) == []
    assert both.counters.drops == {Drop.RETAINED: 1}


@pytest.mark.parametrize("mode", MODES[1:])
def test_what_was_kept_under_a_key_that_is_over_is_old_and_not_of_an_unknown_one(mode: SecurityMode) -> None:
    both = Both(mode)
    kept = both.sealed(announcement())
    group = telemetry_group(1)
    both.opening.install(group, group_keys(5, seed=f"0{group}"), both.now)
    assert both.hear(kept, is_fresh=False) == [], "its source is not said to be refused"
    assert both.counters.drops == {Drop.RETAINED: 1}
    to_come = envelope(1, group, mode=mode)
    to_come.install(group, group_keys(9, seed=f"0{group}"), both.now)
    both.hear(one(to_come.seal(announcement(), both.now)), is_fresh=False)
    assert both.counters.drops == {Drop.RETAINED: 1, Drop.UNKNOWN_TOKEN: 1}
