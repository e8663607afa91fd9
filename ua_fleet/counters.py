"""Counters of one process. Nothing is lost in silence: every drop goes to a counter with its cause."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

__all__ = ["NO_LOSS", "OF_BRIDGES", "Counters", "Drop"]


class Drop(StrEnum):
    """Why a message was dropped. The values are the names that operators see."""

    LOOP = "loop"
    """Our own space's data came back over PubSub."""
    FOREIGN = "foreign"
    """Another bridge brought this data into our space."""
    OWN_PUBLICATION = "own_publication"
    """We heard what we had published into our own space."""
    REPEATED = "repeated"
    """A repeat of a message already handed on: its Timestamp is not new. Normal, each repeat interval."""
    DUPLICATE = "duplicate"
    """A DataSetMessage whose sequence number was received before."""
    LATE = "late"
    """A DataSetMessage that the network delivered after a newer one of its writer; it was counted as a gap before."""
    MALFORMED = "malformed"
    """Bytes that break the rules; `Counters.malformed` has the cause."""
    SECURED = "secured"
    """A message with the security flag, for a process without keys."""
    NOT_SECURED = "not_secured"
    """A message below the SecurityMode of its group: not signed, or signed where it has to be encrypted too."""
    BAD_SIGNATURE = "bad_signature"
    """A signature that is not that of the sender's SecurityGroup: a wrong key, or bytes that were changed."""
    REPLAYED = "replayed"
    """A nonce that was used before or is too old for the replay window."""
    UNKNOWN_TOKEN = "unknown_token"  # noqa: S105 -- a name, not a secret
    """A SecurityTokenId whose key we do not have, or no longer take; keys are asked for."""
    NO_KEY = "no_key"
    """Not sent: there is no key, or it expired, or its nonces are used up."""
    CHUNK_LOST = "chunk_lost"
    """A message of which not all chunks came in time, or that no longer fitted into the bounds."""
    REQUESTOR = "requestor"
    """An ActionRequest of a requestor that may not command this space, or not this skill."""
    TOO_LARGE = "too_large"
    """An ActionRequest with larger arguments than the skill takes; refused, as the next four."""
    TOO_MANY = "too_many"
    """An ActionRequest while as many executions are under way as the skill, or the bridge, takes."""
    TOO_SOON = "too_soon"
    """An ActionRequest within the skill's least interval."""
    TOO_MANY_REQUESTORS = "too_many_requestors"
    """An ActionRequest while as many others ask as the skill takes."""
    REFUSED = "refused"
    """An ActionRequest for another reason: no such skill, wrong arguments, too late, or clocks that differ."""
    INVALID = "invalid"
    """A DataSetMessage that its sender marked as not valid."""
    NO_METADATA = "no_metadata"
    """Data whose metadata is not known yet; it was probed for."""
    NO_KEY_FRAME = "no_key_frame"
    """A delta frame without the key frame that it changes."""
    UNSUPPORTED = "unsupported"
    """An event frame, since a mirrored value comes in key and delta frames; or a setpoint in chunks."""
    LAYOUT = "layout"
    """Fields that do not match the metadata."""
    UNKNOWN_SOURCE = "unknown_source"
    """A source that the policy for unknown sources does not let in."""
    CONFLICT = "conflict"
    """A second source claims the node of another, or another process says that it is this bridge."""
    INLET_FULL = "inlet_full"
    """More messages than the bridge could hand on, from the robot side or, while robots connect, to it; the oldest
    went."""
    TOO_OLD = "too_old"
    """A message that had waited too long in the bridge, and that a newer one of its source has overtaken."""
    KERNEL = "kernel"
    """Datagrams that the kernel dropped because the receive buffer was full."""
    SEND_FAILED = "send_failed"
    """The kernel did not take a datagram."""
    BROKER_AWAY = "broker_away"
    """Not sent while the MQTT broker was away or too slow: of values the newest of each source is sent, no command."""
    EXPIRED = "expired"
    """An Action whose TimeoutHint was over before it could be sent to the MQTT broker."""
    BROKER_REFUSED = "broker_refused"
    """A message that the MQTT broker did not take: no permission, a quota, or too large."""
    RETAINED = "retained"
    """Data, an Action or an old announcement that an MQTT broker had kept: it says nothing of now."""
    NOT_ITS_TOPIC = "not_its_topic"
    """A message on another MQTT topic than its publisher's, or on none of this fleet's."""
    NOT_OVER_JSON = "not_over_json"
    """An Action over a JSON connection without `pubsub.actions`, or a setpoint: nothing of JSON is signed."""
    NOT_ITS_CONNECTION = "not_its_connection"
    """A message of a space whose bridge is not on the connection that it came by, or an Action where none are taken."""
    NOT_RELAYED = "not_relayed"
    """An Action or a setpoint that a relay has heard: it forwards none. Normal, where robots are commanded there."""
    NOT_LISTED = "not_listed"
    """A message of an origin that the relay is not configured to forward from there. Normal, where others speak too."""
    NOT_CONNECTED = "not_connected"
    """A message for a space that the bridge has been put out of."""
    TYPE_MISSING = "type_missing"
    """The message type does not exist in this space."""
    CONVERSION = "conversion"
    """A value that cannot be converted to the type on the other side, or is larger than a message may be."""
    INCOMPATIBLE_QOS = "incompatible_qos"
    """A ROS 2 publisher and subscriber whose qualities of service do not match: nothing passes between the two."""
    UNLINKED = "unlinked"
    """A ROS 1 subscriber that the master names has no link, and its topic is registered again; or it does not answer,
    and what waited for it was dropped."""
    ILLEGAL_TOPIC = "illegal_topic"
    """A name that begins like a UA topic and is none."""
    RATE_LIMITED = "rate_limited"
    """A newer value came before this one's turn. Normal, where a rate limit is configured."""
    UNMAPPED = "unmapped"
    """Data of another space that `fleet.yaml` gives no place in this one. Normal, where robots have no topics."""
    NO_ANSWER = "no_answer"
    """A robot's controller did not answer a request in time."""
    REJECTED = "rejected"
    """A robot's controller answered a request with an error, or did not take what was written."""
    MISBEHAVED = "misbehaved"
    """A source did what no robot should, and was put aside for a while; the bridge says which, and why."""
    UNASKED = "unasked"
    """What a robot said of an execution that nobody waits for: a second time, too late, or of another's."""
    LEASE = "lease"
    """A setpoint for a robot that is driven by hand, without the lease that is held now."""
    NUMBER = "number"
    """A setpoint that is not newer than the last one that was taken."""
    ECHO = "echo"
    """A setpoint that was wished too long ago: the counter that it echoes is older than `deadman_ms`, or unknown."""
    SETPOINT = "setpoint"
    """A setpoint with a value that is no finite number, or with another number of axes; it has stopped the robot."""
    NOT_A_SETPOINT = "not_a_setpoint"
    """Another message for data that takes the setpoints of teleoperation alone."""
    DISABLED = "disabled"
    """Not sent, or not taken: somebody has disabled the DataSetWriter, the DataSetReader, or what it is part of."""
    UNTOLD = "untold"
    """Not counted any more, since clients are told each state and event; for those who watch it."""


NO_LOSS: Final = frozenset({Drop.LOOP, Drop.FOREIGN, Drop.OWN_PUBLICATION, Drop.REPEATED, Drop.DUPLICATE})
"""What was dropped because it was there already, or would have gone round: nobody misses it."""


OF_BRIDGES: Final = tuple(drop for drop in Drop if drop not in (Drop.NOT_RELAYED, Drop.NOT_LISTED))
"""Causes that bridges and the server count, and have in their nodes; the others are a relay's."""


@dataclass(slots=True)
class Counters:
    """What went through a process, and what did not."""

    messages_in: int = 0
    """DataSetMessages received over PubSub, before any drop."""
    messages_out: int = 0
    """DataSetMessages sent over PubSub, repeats and keep-alives included."""
    from_space: int = 0
    """Messages taken from the robot side."""
    to_space: int = 0
    """Messages published into the robot side."""
    gaps: int = 0
    """DataSetMessages that sequence numbers show as missing."""
    looped: int = 0
    """Deliveries of an (origin, writer, SourceTimestamp) at a place where it had been delivered; must stay 0."""
    drops: Counter[str] = field(default_factory=Counter[str])
    malformed: Counter[str] = field(default_factory=Counter[str])
    forgiven: Counter[str] = field(default_factory=Counter[str])
    """What JSON messages did wrong and was read all the same, by name (`docs/json.md`)."""

    def drop(self, cause: Drop, count: int = 1) -> None:
        """Count dropped messages."""
        self.drops[cause] += count

    def drop_malformed(self, cause: str, count: int = 1) -> None:
        """Count messages that could not be decoded; `cause` is that of the RemoteWireError."""
        self.drops[Drop.MALFORMED] += count
        self.malformed[cause] += count
