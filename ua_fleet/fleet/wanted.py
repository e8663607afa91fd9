"""Which data somebody follows: what the server tells a bridge that reads some of its data only then.

One DataSet for each such bridge, in space 0 with the id of the bridge's own status: the ids of the DataSets that are
wanted now. It is a lease: what is wanted is told anew each second, and a bridge that does not hear the server for
MessageReceiveTimeout takes it that nobody wants anything, until it is told anew.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import BuiltinType

__all__ = ["WANTED_FIELDS", "wanted_topic"]

WANTED_FIELDS: Final = (make_field("Wanted", BuiltinType.UINT16, array=True, properties={"NodeOnly": True}),)
"""Fields of the DataSet. It is for bridges alone, and has no form in a robot's space."""


def wanted_topic(status: Topic) -> Topic:
    """The topic by which the bridge with this status is told."""
    return Topic(SERVER_SPACE, status.ns, status.id)
