from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from ua_fleet.operation.skills.addressing import NamedArguments, addressed
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, PublisherIdType
from ua_fleet.wire.packed_fields import PackedFields, pack_fields

ACTION = Topic(300, 2, 1501)
TYPES = (int(BuiltinType.STRING), int(BuiltinType.DOUBLE))
GIVEN = NamedArguments(("place", "speed"), pack_fields(TYPES, ("bin", 0.5)))


def asked(arguments: Mapping[str, Any], **fields: BuiltinType) -> tuple[tuple[int, ...], tuple[Any, ...]]:
    """The types and values of a request to a bridge that announces these arguments."""
    named = tuple([make_field(name, kind) for name, kind in fields.items()])
    request = DataSetMetaData("pick", named, ConfigurationVersion(3, 1))
    targets = (ActionTarget(1, "arm"),)
    action = ActionMetaDataAnnouncement(
        300, PublisherIdType.UINT16, 0, ACTION.id, targets, request, request._replace(fields=())
    )
    _, types, values, version = addressed(action, ACTION, "arm", "pick", arguments)
    assert version == 3
    return types, values


def test_arguments_that_are_packed_as_the_bridge_announces_them_stay_packed() -> None:
    types, values = asked(GIVEN, place=BuiltinType.STRING, speed=BuiltinType.DOUBLE)
    assert types == TYPES
    assert values is GIVEN.packed


@pytest.mark.parametrize(
    "announced",
    [
        {"speed": BuiltinType.DOUBLE, "place": BuiltinType.STRING},
        {"place": BuiltinType.STRING, "speed": BuiltinType.FLOAT},
    ],
    ids=["another order", "other types"],
)
def test_arguments_of_another_order_or_other_types_are_packed_anew(announced: dict[str, BuiltinType]) -> None:
    types, values = asked(GIVEN, **announced)
    assert not isinstance(values, PackedFields)
    assert dict(zip(announced, values, strict=True)) == GIVEN
    assert pack_fields(types, values).content == pack_fields(types, asked(dict(GIVEN), **announced)[1]).content
