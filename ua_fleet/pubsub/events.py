"""What a subscriber tells its owner: facts, in the order in which they happened."""

from __future__ import annotations

from typing import NamedTuple

from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.discovered import AnyAnnouncement
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, Probe

__all__ = [
    "ActionReceived",
    "AnnouncementReceived",
    "DataReceived",
    "EventReceived",
    "MetaDataReceived",
    "ProbeDue",
    "ProbeReceived",
    "SetpointReceived",
    "SourceAppeared",
    "SourceRefused",
    "SourceReturned",
    "SourceSilent",
    "SourceStale",
    "SourceUnknown",
    "SubscriberEvent",
]


class DataReceived(NamedTuple):
    """A key frame with a new Timestamp, checked against its metadata. Handed on exactly once."""

    topic: Topic
    message: DataSetMessage
    metadata: DataSetMetaData


class EventReceived(NamedTuple):
    """An event, checked against its metadata: something that happened, and no state that anything is in."""

    topic: Topic
    message: DataSetMessage
    metadata: DataSetMetaData


class MetaDataReceived(NamedTuple):
    """Metadata that is new, or another version than before. It precedes the first data of that version."""

    topic: Topic
    metadata: DataSetMetaData


class SourceUnknown(NamedTuple):
    """Something was heard of a source whose metadata is not known, also after the delays that probes must keep."""

    topic: Topic
    datagram: bytes | None
    """The probe to send now; None where the probe of a SourceUnknown beside this one asks for this source too."""


class SourceAppeared(NamedTuple):
    """A source of which no value was taken is there: its first keep-alive came. Said once.

    It says nothing of any value: one that somebody has from before may be of an earlier life of the source.
    """

    topic: Topic


class SourceSilent(NamedTuple):
    """Nothing of a source was taken for MessageReceiveTimeout. Said once until it returns."""

    topic: Topic


class SourceStale(NamedTuple):
    """A source is there, but nothing says that its last value is of now: it was started anew, or a message is missing.

    Said once until it returns or is silent.
    """

    topic: Topic


class SourceReturned(NamedTuple):
    """The last value of a silent or stale source is of now again (data, a repeat, or a keep-alive that says so)."""

    topic: Topic
    is_followed: bool = False
    """Whether its new value follows, in a DataReceived: the last one is of now no more then."""


class SourceRefused(NamedTuple):
    """A message of a source was refused for its security, and no valid one is heard: never, or not for long.

    Said once until a valid one is heard, or again after many other sources. Who sent it is not known: the source itself
    with the wrong keys, or somebody else in its name.
    """

    topic: Topic
    drop: Drop
    """Why."""


class ProbeReceived(NamedTuple):
    """Somebody asks our publisher for information."""

    probe: Probe


class ActionReceived(NamedTuple):
    """An ActionRequest to this process, or an ActionResponse of another one, with the further ones of its message.

    The PublisherId of both is the Responder's. What is done for them, the owner decides: the ORIGIN of a request, which
    the loop rule looks at, is the space in its RequestorId, and not its PublisherId.
    """

    message: ActionMessage
    sender: tuple[str, int] | None
    """Where the datagram came from; not proved by anything."""
    verified: bool
    """Whether it carried the signature of the Responder's command group."""


class SetpointReceived(NamedTuple):
    """A DataSetMessage of the WriterGroup in which the server sends setpoints to this process.

    It was checked by nothing but the keys of this space's commands, where there are keys.
    """

    writer_group_id: int
    message: DataSetMessage


class AnnouncementReceived(NamedTuple):
    """An announcement of any kind but metadata came, each time it is heard."""

    announcement: AnyAnnouncement
    is_fresh: bool = True
    """False for what a broker has kept or a relay brings: it may be of any time."""


class ProbeDue(NamedTuple):
    """Something that was wanted (`Subscriber.want`) is to be asked for now."""

    datagram: bytes


SubscriberEvent = (
    DataReceived
    | EventReceived
    | MetaDataReceived
    | SourceUnknown
    | SourceAppeared
    | SourceSilent
    | SourceStale
    | SourceReturned
    | SourceRefused
    | ProbeReceived
    | ActionReceived
    | SetpointReceived
    | AnnouncementReceived
    | ProbeDue
)
