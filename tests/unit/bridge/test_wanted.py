"""What the server wants of a bridge."""

from __future__ import annotations

from ua_fleet.bridge.wanted import Wants
from ua_fleet.fleet.wanted import WANTED_FIELDS, wanted_topic
from ua_fleet.pubsub.events import DataReceived, SourceSilent
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

TOPIC = wanted_topic(Topic(300, 2, 1))
METADATA = DataSetMetaData("pc wanted", WANTED_FIELDS, ConfigurationVersion(1, 1))


def message(*values: object, status: int = 0) -> DataSetMessage:
    return DataSetMessage(1, types=(0x85,) * len(values), values=values, timestamp=1, status=status)


def test_it_tells_each_change_once_and_forgets_with_the_server() -> None:
    told: list[list[int]] = []
    wants = Wants(TOPIC, 300, lambda wanted: told.append(sorted(topic.id for topic in wanted)))
    assert Topic(0, 2, 1) == TOPIC
    for values in ([], [11, 10], [10, 11]):
        wants.hear(DataReceived(TOPIC, message(values), METADATA))
    assert told == [[10, 11]]
    wants.hear(SourceSilent(TOPIC))
    wants.hear(SourceSilent(TOPIC))
    assert told == [[10, 11], []]
    wants.hear(DataReceived(TOPIC, message([10]), METADATA))
    wants.hear(DataReceived(TOPIC, message([10], status=int(StatusCode.BAD_NO_COMMUNICATION)), METADATA))
    assert told == [[10, 11], [], [10], []]


def test_what_is_no_list_of_ids_is_nothing() -> None:
    told: list[object] = []
    wants = Wants(TOPIC, 300, told.append)
    for values in ((), ("all",), (7,), (["x"],)):
        wants.hear(DataReceived(TOPIC, message(*values), METADATA))
    assert told == []


def test_an_id_of_another_namespace_is_wanted_there() -> None:
    told: list[frozenset[Topic]] = []
    wants = Wants(TOPIC, 300, told.append, {11: 4})
    wants.hear(DataReceived(TOPIC, message([10, 11]), METADATA))
    assert told == [frozenset({Topic(300, TOPIC.ns, 10), Topic(300, 4, 11)})]
