"""The topics of a broker that carry OPC UA PubSub as UADP (OPC 10000-14 7.3.4.7).

    <prefix>/uadp/<type>/<PublisherId>[/<WriterGroup>[/<DataSetWriter>]]      levels are names
    <queue>                                                                   of data, e.g. ua_1_2_1005

The queue is a template of `{topic}` or of `{space}`, `{ns}` and `{id}`. A message that is heard on it has to be of
that DataSetWriter, whatever else it says. Messages of foreign publishers come on `<prefix>/uadp/data/...` as well.

Two types are ours, `probe` and `answer`: the standard has none for probes, since what they ask for is retained. A
probe asks for the last values at once, too, which nobody retains.

A name becomes a topic level by escaping what a level cannot hold (`/`, `+`, `#`, NUL), what some brokers refuse
(spaces, other controls), and `%`, as `%` and two hexadecimal digits of UTF-8.
"""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Final, NamedTuple

from ua_fleet.errors import TopicInvalid, TransportError
from ua_fleet.topics import Topic

__all__ = ["MOST_TOPIC_BYTES", "Kind", "Place", "TopicTree", "level_of"]

MOST_TOPIC_BYTES: Final = 1024
"""Longer topics are none of ours. MQTT allows 65,535 bytes."""
_ENCODING: Final = "uadp"
_PLACEHOLDER: Final = re.compile(r"\{([^{}]*)\}")
_FIELDS: Final = ("topic", "space", "ns", "id")
_NUMBER: Final = "(0|[1-9][0-9]{0,4})"
_PLAIN: Final = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-._~!()=,:;@'*&")


class Kind(StrEnum):
    """The MqttMessageType of a topic (OPC 10000-14 table 204), and two of our own."""

    DATA = "data"
    METADATA = "metadata"
    APPLICATION = "application"
    ENDPOINTS = "endpoints"
    STATUS = "status"
    CONNECTION = "connection"
    ACTION_REQUEST = "action-request"
    ACTION_RESPONSE = "action-response"
    ACTION_METADATA = "action-metadata"
    ACTION_RESPONDER = "action-responder"
    PROBE = "probe"
    ANSWER = "answer"

    @property
    def is_kept(self) -> bool:
        """Whether the broker keeps the last message of such a topic (RETAIN)."""
        return self in _KEPT

    @property
    def is_discovery(self) -> bool:
        """Whether its messages are probes or announcements."""
        return self in _KEPT or self in (Kind.PROBE, Kind.ANSWER)


_KEPT: Final = frozenset(
    {
        Kind.METADATA,
        Kind.APPLICATION,
        Kind.ENDPOINTS,
        Kind.STATUS,
        Kind.CONNECTION,
        Kind.ACTION_METADATA,
        Kind.ACTION_RESPONDER,
    }
)
_DEPTHS: Final = {
    Kind.DATA: (2, 3),
    Kind.METADATA: (3,),
    Kind.ACTION_METADATA: (3,),
    Kind.ACTION_REQUEST: (2,),
    Kind.ACTION_RESPONSE: (2, 3),
}
"""Levels from the PublisherId on; one where a kind is not named here."""


class Place(NamedTuple):
    """What a topic says of the messages on it."""

    kind: Kind
    publisher: str
    """The PublisherId as text."""
    source: Topic | None = None
    """Of a queue of data: the DataSetWriter that alone may send there."""


def level_of(name: str) -> str:
    """A name as one topic level."""
    if name and all(character in _PLAIN for character in name):
        return name
    escaped = [
        character if character in _PLAIN else "".join(f"%{byte:02X}" for byte in character.encode("utf-8", "replace"))
        for character in name
    ]
    return "".join(escaped) or "%00"


class TopicTree:
    """The topics of a fleet."""

    def __init__(self, prefix: str = "opcua", queue: str = "{topic}") -> None:
        """Make a tree; raises TransportError for a prefix or a queue that cannot be one."""
        for what, text in (("prefix", prefix), ("queue", queue)):
            if problem := _problem(text):
                raise TransportError(f"{what} {text!r}: {problem}")
        self._base = f"{prefix}/{_ENCODING}/"
        self._queue = queue
        names = _PLACEHOLDER.findall(queue)
        unknown = [name for name in names if name not in _FIELDS]
        if unknown or "{" in _PLACEHOLDER.sub("", queue) or "}" in _PLACEHOLDER.sub("", queue):
            raise TransportError(f"queue {queue!r}: only {{topic}}, {{space}}, {{ns}} and {{id}} are filled in")
        if "topic" not in names and not {"space", "ns", "id"} <= set(names):
            raise TransportError(f"queue {queue!r}: two sources could share it; write {{topic}}, or all of the others")
        if len(names) != len(set(names)):
            raise TransportError(f"queue {queue!r}: each placeholder may stand there once")
        if queue.startswith(self._base):
            raise TransportError(f"queue {queue!r}: {self._base} is where the standard topics are")
        self._pattern = re.compile(_pattern(queue), re.ASCII)
        self._queue_filter = "/".join("+" if "{" in level else level for level in queue.split("/"))

    def queue(self, source: Topic) -> str:
        """Where the data of a DataSetWriter goes."""
        return self._queue.format(topic=source.name, space=source.space, ns=source.ns, id=source.id)

    def topic(self, kind: Kind, publisher: int | str, *names: str) -> str:
        """A topic of the standard tree; `names` are those of a WriterGroup and a DataSetWriter."""
        return "/".join([self._base + kind.value, level_of(str(publisher)), *map(level_of, names)])

    def filters(self, own: int | None) -> list[str]:
        """What to subscribe to: all that is said, and the requests to one Responder; to all of them for a listener."""
        kinds = [kind for kind in Kind if kind is not Kind.ACTION_REQUEST]
        found = [self._queue_filter, *(f"{self._base}{kind.value}/#" for kind in kinds)]
        return [*found, f"{self._base}{Kind.ACTION_REQUEST.value}/{'+' if own is None else own}/+"]

    def answer(self, topic: str) -> str | None:
        """Where the response to a request goes that came on a topic; None for a topic of no request."""
        head = f"{self._base}{Kind.ACTION_REQUEST.value}/"
        return f"{self._base}{Kind.ACTION_RESPONSE.value}/{topic[len(head) :]}" if topic.startswith(head) else None

    def response_topic(self, wanted: str) -> str | None:
        """The topic of a ResponseAddress, where a response may go there; otherwise None.

        Only topics of responses: else one small request of anybody could have us write to any topic of the broker.
        """
        place = self.read(wanted)
        return wanted if place is not None and place.kind is Kind.ACTION_RESPONSE else None

    def read(self, topic: str) -> Place | None:
        """What a topic says; None where it is none of this tree."""
        if len(topic) > MOST_TOPIC_BYTES:
            return None
        if not topic.startswith(self._base):
            return self._read_queue(topic)
        word, *levels = topic[len(self._base) :].split("/")
        try:
            kind = Kind(word)
        except ValueError:
            return None
        if len(levels) not in _DEPTHS.get(kind, (1,)) or not all(map(_is_level, levels)):
            return None
        return Place(kind, levels[0])

    def _read_queue(self, topic: str) -> Place | None:
        match = self._pattern.fullmatch(topic)
        if match is None:
            return None
        found = {name: int(number) for name, number in match.groupdict().items()}
        for name in ("space", "ns", "id"):
            if (again := found.get(f"topic_{name}")) is not None and found.setdefault(name, again) != again:
                return None
        try:
            source = Topic.checked(found["space"], found["ns"], found["id"])
        except TopicInvalid:
            return None
        return Place(Kind.DATA, str(source.space), source)


def _pattern(queue: str) -> str:
    parts: list[str] = []
    for index, part in enumerate(_PLACEHOLDER.split(queue)):
        if index % 2 == 0:
            parts.append(re.escape(part))
        elif part == "topic":
            parts.append("ua_" + "_".join(f"(?P<topic_{name}>{_NUMBER[1:-1]})" for name in ("space", "ns", "id")))
        else:
            parts.append(f"(?P<{part}>{_NUMBER[1:-1]})")
    return "".join(parts)


def _problem(text: str) -> str:
    """Why a text cannot be a part of a topic; empty where it can."""
    if not text or text.startswith(("/", "$")) or text.endswith("/"):
        return "it is empty, or begins with / or $, or ends with /"
    if any(character in "+#" or character <= " " or character == "\x7f" for character in text):
        return "it has a wildcard (+ #), a space or a control character"
    if len(text.encode()) > MOST_TOPIC_BYTES // 2:
        return f"it is longer than {MOST_TOPIC_BYTES // 2} bytes"
    return ""


def _is_level(level: str) -> bool:
    return bool(level) and not any(character in "+#" or character < " " or character == "\x7f" for character in level)
