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


def of_version(number: int) -> DataSetMetaData:
    return described(number)._replace(configuration_version=ConfigurationVersion(number, number))


def test_an_older_version_that_is_kept_or_relayed_describes_what_names_it_and_nothing_else() -> None:
    """A publisher may be started anew while its clock is behind; and anybody may have recorded its past."""
    catalog, key = Catalog(100), (2, 1)
    writer = RemoteWriter(Topic(2, 2, 1), 0.0, Counters())
    catalog.announced(key, of_version(5))
    catalog.add_writer(writer)
    assert not catalog.announced(key, of_version(3), is_fresh=False)
    assert catalog.find(key, DataSetMessage(1, major_version=3, minor_version=3)) == of_version(3)
    assert catalog.find(key, DataSetMessage(1)) == of_version(5)
    assert not catalog.announced(
        key, described(9)._replace(configuration_version=ConfigurationVersion(3, 3)), is_fresh=False
    )
    assert catalog.find(key, DataSetMessage(1, major_version=3, minor_version=3)) == of_version(3), (
        "it is known already"
    )
    for number in (6, 7, 8):
        assert catalog.announced(key, of_version(number), is_fresh=False)
    assert catalog.find(key, DataSetMessage(1, major_version=3, minor_version=3)) is None
    assert not catalog.announced(key, of_version(4), is_fresh=False)
    assert catalog.find(key, DataSetMessage(1, major_version=4, minor_version=4)) is None, (
        "it pushes out none that is later"
    )


def test_older_versions_that_nobody_has_sent_data_for_are_bounded_too() -> None:
    catalog = Catalog(100)
    for number in range(1, 11):
        catalog.announced((2, number), of_version(100))
        catalog.announced((2, number), of_version(99), is_fresh=False)
    found = [number for number in range(1, 11) if catalog.find((2, number), DataSetMessage(1)) is not None]
    assert 0 < len(found) < 4
    assert found[-1] == 10


def test_small_ones_are_bounded_by_their_number() -> None:
    catalog = Catalog(100)
    for number in range(1, 151):
        catalog.announced((2, number), described(1))
    assert [number for number in range(1, 151) if catalog.find((2, number), DATA) is not None] == list(range(51, 151))


def test_what_a_writer_was_heard_for_gives_its_room_back() -> None:
    catalog = Catalog(100)
    for number in range(1, 26):
        catalog.announced((2, number), described(20))
        catalog.add_writer(RemoteWriter(Topic(2, 2, number), 0.0, Counters()))
    assert all(catalog.find((2, number), DATA) is not None for number in range(1, 26))


def test_what_writers_were_heard_for_is_bounded_too_and_the_newcomer_has_no_room() -> None:
    catalog = Catalog(100)
    honest = RemoteWriter(Topic(2, 2, 1), 0.0, Counters())
    catalog.announced((2, 1), described(10))
    catalog.add_writer(honest)
    strangers = [RemoteWriter(Topic(3, 2, number), 0.0, Counters()) for number in range(1, 101)]
    for stranger in strangers:
        catalog.announced(stranger.key, described(20))
        catalog.add_writer(stranger)
    known = [stranger for stranger in strangers if catalog.find(stranger.key, DATA) is not None]
    assert known == strangers[: len(known)]
    assert 10 < len(known) < 40
    assert catalog.find(honest.key, DATA) is not None
    # One that changes has its newest, as long as that fits.
    changed = described(10)._replace(configuration_version=ConfigurationVersion(2, 2))
    catalog.announced(honest.key, changed)
    assert catalog.find(honest.key, DataSetMessage(1, major_version=2, minor_version=2)) == changed
    for stranger in known:
        catalog.remove_writer(stranger)
    catalog.announced(strangers[-1].key, described(20))
    assert catalog.find(strangers[-1].key, DATA) is not None


def test_versions_of_one_writer_make_room_for_its_newest() -> None:
    catalog = Catalog(10)
    writer = RemoteWriter(Topic(2, 2, 1), 0.0, Counters())
    catalog.add_writer(writer)
    for number in range(1, 4):
        metadata = described(40)._replace(configuration_version=ConfigurationVersion(number, number))
        catalog.announced(writer.key, metadata)
    found = [
        number
        for number in range(1, 4)
        if catalog.find(writer.key, DataSetMessage(1, major_version=number, minor_version=number)) is not None
    ]
    assert found == [3]
