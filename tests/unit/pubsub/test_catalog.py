"""What is kept of announcements that no data came for."""

from __future__ import annotations

from ua_fleet.counters import Counters
from ua_fleet.pubsub.catalog import Catalog
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

DATA = DataSetMessage(1, major_version=1, minor_version=1)


def described(fields: int) -> DataSetMetaData:
    version = ConfigurationVersion(1, 1)
    return DataSetMetaData("a", tuple(make_field(f"f{n}", BuiltinType.DOUBLE) for n in range(fields)), version)


def test_large_descriptions_push_out_the_oldest_that_nobody_has_sent_data_for() -> None:
    """2,000 announcements of 300 fields grew a server by 209 MB, and went on so."""
    catalog = Catalog(100)
    catalog.announced((2, 1), described(1))
    catalog.add_writer(RemoteWriter(Topic(2, 2, 1), 0.0, Counters()))
    for number in range(2, 12):
        catalog.announced((2, number), described(100))
    kept = [number for number in range(1, 12) if catalog.find((2, number), DATA) is not None]
    assert kept == [1, 9, 10, 11]


def test_small_ones_are_bounded_by_their_number() -> None:
    catalog = Catalog(100)
    for number in range(1, 151):
        catalog.announced((2, number), described(1))
    assert [number for number in range(1, 151) if catalog.find((2, number), DATA) is not None] == list(range(51, 151))


def test_what_a_writer_was_heard_for_gives_its_room_back() -> None:
    catalog = Catalog(100)
    for number in range(1, 20):
        catalog.announced((2, number), described(100))
        catalog.add_writer(RemoteWriter(Topic(2, 2, number), 0.0, Counters()))
    assert all(catalog.find((2, number), DATA) is not None for number in range(1, 20))
