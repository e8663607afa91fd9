"""Which SecurityGroup a message belongs to. This is the only place that knows how groups are named.

Each publishing process has two (OPC 10000-14 6.2.12): `t-<PublisherId>` for what it publishes to all, and
`c-<PublisherId>` for Actions, requests and responses alike, whose keys only it and its permitted requestors have.
SecurityTokenIds are not unique over groups, so a key is never chosen by its token alone.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.wire.messages import PublisherIdType

__all__ = ["command_group", "group_of", "telemetry_group"]

_UINT16: Final = PublisherIdType.UINT16.value


def telemetry_group(publisher_id: int) -> str:
    """The group of the data and announcements of a publisher."""
    return f"t-{publisher_id}"


def command_group(publisher_id: int) -> str:
    """The group of the Actions of a responder."""
    return f"c-{publisher_id}"


def group_of(
    publisher_id: int | str | None, publisher_id_type: int, writer_group_id: int | None, is_action: bool
) -> str | None:
    """The group of a message by what its headers say; None for a publisher that is no space and so has no group.

    All WriterGroups of a publisher share its groups: they run in one process, which has one key for each purpose.
    """
    del writer_group_id
    if publisher_id_type != _UINT16 or type(publisher_id) is not int:
        return None
    return command_group(publisher_id) if is_action else telemetry_group(publisher_id)
