"""Writers and readers of OPC UA PubSub (OPC 10000-14): pure, time is an argument.

`now` is float seconds of any clock that only moves forward; Timestamps are ticks (see `ua_fleet.values`).

    publisher = Publisher(space, timing, counters, codec)         # the DataSetWriters of a process
    publisher.begin / announce / publish / source_lost / answer / poll / announce_action / end
                                                                  -> list of datagrams to send, in order
    subscriber = Subscriber(space, timing, counters, codec)       # its DataSetReaders
    subscriber.receive(datagram, now) / poll(now)                 -> list of facts (events.py)

Call each `poll` at its `next_deadline()`, which every other call may change.
"""

from ua_fleet.pubsub.action_catalog import ActionCatalog
from ua_fleet.pubsub.application import Application, describe
from ua_fleet.pubsub.complaints import Complaint
from ua_fleet.pubsub.events import (
    AnnouncementReceived,
    DataReceived,
    EventReceived,
    MetaDataReceived,
    ProbeDue,
    ProbeReceived,
    SourceAppeared,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.metadata import PropertyValue, field_property, first_property, make_field, type_code, type_codes
from ua_fleet.pubsub.publisher import MAX_DATAGRAM_BYTES, Publisher
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.pubsub.subscriber import LoopRule, Subscriber
from ua_fleet.pubsub.timing import PubSubTiming, version_time

__all__ = [
    "MAX_DATAGRAM_BYTES",
    "ActionCatalog",
    "AnnouncementReceived",
    "Application",
    "Complaint",
    "DataReceived",
    "EventReceived",
    "LoopRule",
    "MetaDataReceived",
    "ProbeDue",
    "ProbeReceived",
    "PropertyValue",
    "PubSubTiming",
    "Publisher",
    "RemoteWriter",
    "SourceAppeared",
    "SourceRefused",
    "SourceReturned",
    "SourceSilent",
    "SourceStale",
    "SourceUnknown",
    "Subscriber",
    "SubscriberEvent",
    "describe",
    "field_property",
    "first_property",
    "make_field",
    "type_code",
    "type_codes",
    "version_time",
]
