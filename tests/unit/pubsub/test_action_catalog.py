"""The catalog of Actions: the newest one counts, and it never grows beyond its bounds."""

from __future__ import annotations

from tests.unit.pubsub.publishing import FIELDS
from ua_fleet.pubsub import ActionCatalog, make_field
from ua_fleet.values import BuiltinType
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData, PublisherIdType


def action(
    writer_id: int, *, version: int = 1, targets: int = 1, fields: tuple[FieldMetaData, ...] = FIELDS, number: int = 0
) -> ActionMetaDataAnnouncement:
    metadata = DataSetMetaData("move", fields, ConfigurationVersion(version, version))
    who = tuple(ActionTarget(target, f"arm {target}") for target in range(targets))
    return ActionMetaDataAnnouncement(2, PublisherIdType.UINT16, number, writer_id, who, metadata, metadata)


def test_the_newest_announcement_counts() -> None:
    catalog = ActionCatalog()
    assert catalog.find(2, 7) is None
    assert catalog.apply(action(7))
    assert not catalog.apply(action(7, number=5)), "said again"
    changed = action(7, version=2, targets=3, fields=FIELDS[:1])
    assert catalog.apply(changed)
    assert catalog.find(2, 7) == changed
    assert catalog.apply(action(7, targets=0)), "retired"
    assert not catalog.apply(action(7, targets=0))
    assert dict(catalog.actions) == {}


def test_what_cannot_be_used_is_not_taken() -> None:
    catalog = ActionCatalog(most_bytes=1000)
    good = action(7)
    other_name = good._replace(response=good.response._replace(name="other"))
    other_version = good._replace(response=good.response._replace(configuration_version=ConfigurationVersion(9, 9)))
    no_type = action(7, fields=(FieldMetaData("x", BuiltinType.NULL),))
    too_large = action(7, targets=200)
    for bad in (other_name, other_version, no_type, too_large):
        assert not catalog.apply(bad)
        assert catalog.find(2, 7) is None
    catalog.apply(good)
    assert not catalog.apply(other_version)
    assert catalog.find(2, 7) == good
    assert catalog.apply(too_large), "the Action that was known has changed, to one that is not kept"
    assert catalog.find(2, 7) is None


def test_it_is_bounded_in_number_and_what_is_announced_again_stays() -> None:
    catalog = ActionCatalog(most=3)
    for writer_id in range(1, 100):
        catalog.apply(action(writer_id))
        catalog.apply(action(1, number=writer_id))
    assert [writer_id for _, writer_id in catalog.actions] == [98, 99, 1]


def test_it_is_bounded_in_bytes() -> None:
    size = len(encode_announcement(action(1)))
    catalog = ActionCatalog(most_bytes=3 * size)
    for writer_id in range(1, 100):
        catalog.apply(action(writer_id))
    assert [writer_id for _, writer_id in catalog.actions] == [97, 98, 99]
    large = action(100, fields=(*FIELDS, make_field("a" * (size // 4), BuiltinType.DOUBLE)))
    catalog.apply(large)
    kept = sum(len(encode_announcement(found)) for found in catalog.actions.values())
    assert kept <= 3 * size
    assert catalog.find(2, 100) == large
