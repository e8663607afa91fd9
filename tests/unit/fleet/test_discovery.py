"""Sources that fleet.yaml does not name."""

from __future__ import annotations

import pytest

from tests.unit.fleet.fleet_of import DOUBLE, STRING, Fleet, fleet_config, message, metadata_of, notices, values
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import UnknownSources
from ua_fleet.counters import Counters, Drop
from ua_fleet.fleet import (
    Change,
    FleetState,
    Noticed,
    SourceAdded,
    SourceQuarantined,
    SourceRemoved,
    ValueChanged,
)
from ua_fleet.fleet.changes import SourceReleased
from ua_fleet.fleet.discovery import CHANGES_OF_ALL, CHANGES_OF_ONE
from ua_fleet.pubsub.events import DataReceived, MetaDataReceived, SourceSilent
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

TOPIC = Topic(5, 2, 700)
SINGLE = metadata_of(make_field("data", DOUBLE, properties={"RosType": "std_msgs/Float64"}), name="/speed")


def test_create_makes_read_only_nodes_with_the_announced_names() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    changes = fleet.hear(TOPIC, [DOUBLE], [1.5], 4, metadata=SINGLE)
    added = next(change for change in changes if isinstance(change, SourceAdded)).data_set
    assert (added.topic, added.name, added.is_single, added.writable) == (TOPIC, "/speed", True, False)
    assert values(changes)[700] == (1.5, 0, 4)
    assert changes.index(SourceAdded(added)) == 0
    assert fleet.counters.drops == {}


def test_several_fields_become_an_object_with_variables() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    metadata = metadata_of(make_field("linear.x", DOUBLE), make_field("frame", STRING))
    changes = fleet.hear(TOPIC, [DOUBLE, STRING], [1.0, "map"], 4, metadata=metadata)
    assert values(changes) == {"700.linear.x": (1.0, 0, 4), "700.frame": ("map", 0, 4)}


def test_other_fields_than_before_make_other_nodes() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    fleet.hear(TOPIC, [DOUBLE], [1.5], 4, metadata=SINGLE)
    metadata = metadata_of(make_field("x", DOUBLE), make_field("y", DOUBLE), version=2)
    changes = fleet.state.apply(MetaDataReceived(TOPIC, metadata), 1)
    assert [type(change) for change in changes[:2]] == [SourceRemoved, SourceAdded]
    assert values(fleet.hear(TOPIC, [DOUBLE, DOUBLE], [1.0, 2.0], 5, metadata=metadata))["700.y"] == (2.0, 0, 5)


def test_the_same_fields_again_change_nothing() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    fleet.hear(TOPIC, [DOUBLE], [1.5], 4, metadata=SINGLE)
    again = metadata_of(*SINGLE.fields, name=SINGLE.name, version=2)
    assert fleet.state.apply(MetaDataReceived(TOPIC, again), 1) == []


def test_quarantine_lists_without_values() -> None:
    fleet = Fleet(UnknownSources.QUARANTINE)
    changes = fleet.state.apply(MetaDataReceived(TOPIC, SINGLE), 1)
    listed = [change for change in changes if isinstance(change, SourceQuarantined)]
    assert [(one.topic, one.name, one.message_type) for one in listed] == [(TOPIC, "/speed", "std_msgs/Float64")]
    assert "quarantine" in listed[0].reason
    for timestamp in (1, 2):
        assert fleet.hear(TOPIC, [DOUBLE], [1.5], timestamp, metadata=SINGLE) == []
    assert fleet.counters.drops == {Drop.UNKNOWN_SOURCE: 2}


def test_ignore_counts_only() -> None:
    fleet = Fleet(UnknownSources.IGNORE)
    assert fleet.hear(TOPIC, [DOUBLE], [1.5], 1, metadata=SINGLE) == []
    assert fleet.counters.drops == {Drop.UNKNOWN_SOURCE: 1}


@pytest.mark.parametrize("policy", [UnknownSources.CREATE, UnknownSources.QUARANTINE])
def test_there_is_a_bound_that_is_told_once(policy: UnknownSources) -> None:
    fleet = Fleet(policy, max_sources=2)
    told: list[str] = []
    for number in range(5):
        told += notices(fleet.hear(TOPIC._replace(id=700 + number), [DOUBLE], [1.0], 1, metadata=SINGLE))
    assert sum("more than 2 unknown sources" in text for text in told) == 1
    assert len(told) == 3
    assert fleet.counters.drops[Drop.UNKNOWN_SOURCE] == (3 if policy is UnknownSources.CREATE else 5)


@pytest.mark.parametrize("ns", [1, 3, 4])
def test_nodes_are_made_in_the_fleets_namespace_alone(ns: int) -> None:
    fleet = Fleet(UnknownSources.CREATE)
    changes = fleet.hear(Topic(5, ns, 700), [DOUBLE], [1.0], 1, metadata=SINGLE)
    assert not any(isinstance(change, SourceAdded) for change in changes)
    assert "namespace index" in next(c for c in changes if isinstance(c, SourceQuarantined)).reason
    assert fleet.counters.drops[Drop.UNKNOWN_SOURCE] == 1


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ((), "no fields"),
        (tuple(make_field(f"f{n}", DOUBLE) for n in range(501)), "501 fields"),
        ((make_field("a", DOUBLE), make_field("a", DOUBLE)), "not unique"),
        ((make_field("", DOUBLE),), "empty"),
        ((make_field("a", BuiltinType.DIAGNOSTIC_INFO),), "no Variable has"),
        ((make_field("a", 29),), "no Variable has"),
    ],
)
def test_metadata_that_makes_no_sense_is_quarantined(fields: tuple[FieldMetaData, ...], reason: str) -> None:
    fleet = Fleet(UnknownSources.CREATE)
    changes = fleet.state.apply(MetaDataReceived(TOPIC, metadata_of(*fields)), 1)
    assert reason in next(change for change in changes if isinstance(change, SourceQuarantined)).reason


def test_the_first_of_two_unknown_sources_keeps_the_node() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    fleet.hear(TOPIC, [DOUBLE], [1.0], 1, metadata=SINGLE)
    assert values(fleet.hear(TOPIC._replace(space=6), [DOUBLE], [2.0], 1, metadata=SINGLE)) == {}
    assert fleet.counters.drops == {Drop.CONFLICT: 1}


def test_long_names_are_cut() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    changes = fleet.state.apply(MetaDataReceived(TOPIC, metadata_of(make_field("x", DOUBLE), name="n" * 5000)), 1)
    added = next(change for change in changes if isinstance(change, SourceAdded)).data_set
    assert len(added.name) == 128


def test_an_id_that_a_skill_has_is_a_conflict_whatever_the_space() -> None:
    robots = {
        "arm": {
            "bridge": "mobile",
            "skill_status_id": 1800,
            "skills": {"grab": {"id": 1700, "timeout_s": 5}},
        }
    }
    model = fleet_model(fleet_config(robots))
    counters = Counters()
    state = FleetState(model, counters, unknown_sources=UnknownSources.CREATE)
    for number, topic in enumerate((Topic(5, 2, 1700), Topic(2, 2, 1700)), start=1):
        changes = state.apply(MetaDataReceived(topic, SINGLE), 1)
        assert not [change for change in changes if isinstance(change, SourceAdded)]
        (said,) = notices(changes)
        assert "claims the node of the skill ua_2_2_1700" in said
        assert state.apply(DataReceived(topic, message([DOUBLE], [1.0]), SINGLE), 1) == []
        assert counters.drops[Drop.CONFLICT] == number
    state.remove_robot("arm")
    changes = state.apply(MetaDataReceived(Topic(5, 2, 1700), SINGLE), 1)
    assert isinstance(changes[0], SourceAdded)


def layout(number: int, fields: int = 2) -> DataSetMetaData:
    return metadata_of(*(make_field(f"v{number}.{field}", DOUBLE) for field in range(fields)), version=number)


def announce(fleet: Fleet, topic: Topic, metadata: DataSetMetaData, at_s: float) -> list[Change]:
    return fleet.state.apply(MetaDataReceived(topic, metadata), int(at_s * TICKS_PER_SECOND))


def kinds(changes: list[Change]) -> list[type]:
    return [type(change) for change in changes if not isinstance(change, ValueChanged)]


def test_a_source_that_changes_too_often_is_put_aside_for_a_minute() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    seen = [announce(fleet, TOPIC, layout(number), 100 + number) for number in range(20)]
    assert sum(SourceAdded in kinds(changes) for changes in seen) == 1 + CHANGES_OF_ONE
    aside = seen[1 + CHANGES_OF_ONE]
    assert kinds(aside) == [SourceRemoved, SourceQuarantined, Noticed]
    assert "too often" in next(change for change in aside if isinstance(change, SourceQuarantined)).reason
    assert not any(seen[2 + CHANGES_OF_ONE :])
    fleet.now = 120 * TICKS_PER_SECOND
    assert fleet.hear(TOPIC, [DOUBLE] * 2, [1.0, 2.0], 4, metadata=layout(19)) == []
    again = announce(fleet, TOPIC, layout(19), 100 + 1 + CHANGES_OF_ONE + 60)
    assert kinds(again)[:2] == [SourceReleased, SourceAdded]
    assert values(fleet.hear(TOPIC, [DOUBLE] * 2, [1.0, 2.0], 5, metadata=layout(19)))["700.v19.1"] == (2.0, 0, 5)


def test_all_unknown_sources_change_no_more_often_than_so() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    topics = [TOPIC._replace(id=1 + number) for number in range(100)]
    seen: list[Change] = []
    for topic in topics:
        announce(fleet, topic, layout(0), 100)
    for number in range(1, 4):
        for topic in topics:
            seen += announce(fleet, topic, layout(number), 110)
    assert sum(isinstance(change, SourceAdded) for change in seen) == CHANGES_OF_ALL
    assert len(notices(seen)) == 2  # one that tells of a change, and one of those that were put aside
    later = [change for topic in topics for change in announce(fleet, topic, layout(9), 171)]
    assert sum(isinstance(change, SourceAdded) for change in later) == CHANGES_OF_ALL
    assert "more such changes since the last line" in notices(later)[0]


def test_a_clock_that_was_set_back_puts_nobody_aside_for_longer() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    for number in range(20):
        announce(fleet, TOPIC, layout(number), 10_000)
    assert SourceAdded in kinds(announce(fleet, TOPIC, layout(19), 100))


def test_unknown_sources_have_a_bounded_number_of_fields() -> None:
    fleet = Fleet(UnknownSources.CREATE, max_sources=10)
    first, second = (TOPIC._replace(id=1 + number) for number in range(2))
    assert SourceAdded in kinds(announce(fleet, first, layout(0, 150), 1))
    (refused, _) = announce(fleet, second, layout(1, 51), 2)
    assert isinstance(refused, SourceQuarantined)
    assert "raise server.max_discovered_sources" in refused.reason
    assert SourceAdded in kinds(announce(fleet, first, layout(2, 100), 3))
    assert kinds(announce(fleet, second, layout(3, 51), 4))[:2] == [SourceReleased, SourceAdded]


def test_what_was_listed_for_its_metadata_is_not_any_more_when_it_has_nodes() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    assert SourceQuarantined in kinds(announce(fleet, TOPIC, metadata_of(), 1))
    assert kinds(announce(fleet, TOPIC, SINGLE, 2))[:2] == [SourceReleased, SourceAdded]
    assert kinds(announce(fleet, TOPIC, metadata_of(version=3), 3))[:2] == [SourceRemoved, SourceQuarantined]


def test_strangers_that_come_and_go_are_a_line_a_minute() -> None:
    fleet = Fleet(UnknownSources.CREATE)
    topics = [TOPIC._replace(id=1 + number) for number in range(20)]
    told: list[str] = []
    for second in range(100, 190):
        fleet.now = second * TICKS_PER_SECOND
        for topic in topics:
            if second % 2:
                told += notices(fleet.state.apply(SourceSilent(topic), fleet.now))
            else:
                fleet.hear(topic, [DOUBLE], [1.0], second, metadata=SINGLE)
    assert len(told) == 2
    assert "is silent" in told[0]
    assert "(and 599 more such changes since the last line)" in told[1]
