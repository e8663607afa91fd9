"""What there is to say about datagrams that were not taken, without a flood.

Once for each cause, then at most once a minute.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from ua_fleet.counters import Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.wire.messages import NetworkMessage, PublisherIdType

__all__ = ["Complaint", "Complaints"]

_SILENCE_S: Final = 60.0
_MALFORMED: Final = "malformed datagrams"
_REFUSED: Final = "refused messages"
_UNKNOWN: Final = Drop.UNKNOWN_SOURCE.value
_ID_TYPES: Final = {int(kind): kind.name.title().replace("Uint", "UInt") for kind in PublisherIdType}


@dataclass(frozen=True, slots=True)
class Complaint:
    """Datagrams that were not taken for one cause, since the last complaint about it."""

    cause: str
    count: int
    detail: str
    """What was wrong with the latest of them, and of those that were refused what to do about it."""
    is_refused: bool = False
    """Refused for their security, in place of malformed."""

    what: str = _MALFORMED
    """What the log calls them."""


class Complaints:
    """Collects what the owner logs. There are as many causes as the codec and the counters have, so it is bounded."""

    def __init__(self) -> None:
        self._open: dict[str, Complaint] = {}
        self._said_at: dict[str, float] = {}

    def add(self, error: RemoteWireError) -> None:
        """Note a datagram that could not be decoded or was refused."""
        cause = error.cause
        is_refused = isinstance(error, DatagramRefused)
        before = self._open.get(cause)
        count = 1 if before is None else before.count + 1
        self._open[cause] = Complaint(cause, count, str(error), is_refused, _REFUSED if is_refused else _MALFORMED)

    def add_unknown(self, message: NetworkMessage) -> None:
        """Note a message of a publisher that is no source of the fleet, and cannot become one by itself."""
        before = self._open.get(_UNKNOWN)
        if before is not None:
            self._open[_UNKNOWN] = replace(before, count=before.count + 1)
            return
        publisher_id, group_id = message.publisher_id, message.writer_group_id
        ids = ", ".join([str(part.data_set_writer_id) for part in message.messages[:4]])
        kind = _ID_TYPES.get(message.publisher_id_type, "")
        detail = (
            f"PublisherId {str(publisher_id)[:64]!a} ({kind}), WriterGroupId {group_id}, DataSetWriterId {ids}: "
            "this is no address of a node; name it in `sources` of fleet.yaml"
        )
        self._open[_UNKNOWN] = Complaint(_UNKNOWN, 1, detail, what="messages of no source of the fleet")

    def take(self, now: float) -> list[Complaint]:
        """What is to be logged now; nothing is returned twice."""
        if not self._open:
            return []
        said_at = self._said_at
        due = [cause for cause in self._open if now - said_at.get(cause, float("-inf")) >= _SILENCE_S]
        for cause in due:
            said_at[cause] = now
        return [self._open.pop(cause) for cause in due]
