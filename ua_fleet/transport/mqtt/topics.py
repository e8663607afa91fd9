"""The topics of a broker that carry OPC UA PubSub, as UADP or JSON (OPC 10000-14 7.3.4.7).

    <prefix>/<uadp|json>/<type>/<PublisherId>[/<WriterGroup>[/<DataSetWriter>]]      levels are names
    <queue>                                                                   of data, e.g. ua_1_2_1005

The queue is a template of `{topic}` or of `{space}`, `{ns}` and `{id}`. A message that is heard on it has to be of
that DataSetWriter, whatever else it says. Messages of foreign publishers come on `<prefix>/<encoding>/data/...` too.

Two types are ours, `probe` and `answer`, and of UADP alone: the standard has none for probes, since what they ask for
is retained. A probe asks for the last values at once, too, which nobody retains.

A name becomes a topic level by escaping what a level cannot hold (`/`, `+`, `#`, NUL), what some brokers refuse
(spaces, other controls), and `%`, as `%` and two hexadecimal digits of UTF-8.
"""

from __future__ import annotations

import re
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

from ua_fleet.errors import TopicInvalid, TransportError
from ua_fleet.topics import Topic

if TYPE_CHECKING:  # with it comes what opens and closes messages
    from ua_fleet.pubsub.publisher_ids import PublisherIds

__all__ = ["ACTION_KINDS", "MOST_REMEMBERED", "MOST_TOPIC_BYTES", "Kind", "Place", "TopicTree", "level_of"]

MOST_TOPIC_BYTES: Final = 1024
"""Longer topics are none of ours. MQTT allows 65,535 bytes."""
MOST_REMEMBERED: Final = 16_384
"""Topics of which it is known what they say: those of so many sources that send in turn."""
_REMEMBERED_LENGTH: Final = 128
"""Longer ones are read each time, so that topics of strangers take a few megabytes at most."""
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
ACTION_KINDS: Final = frozenset(
    {Kind.ACTION_REQUEST, Kind.ACTION_RESPONSE, Kind.ACTION_METADATA, Kind.ACTION_RESPONDER}
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
    names: tuple[str, ...] = ()
    """The levels of a WriterGroup and a DataSetWriter."""


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

    def __init__(
        self,
        prefix: str = "opcua",
        queue: str = "{topic}",
        *,
        is_json: bool = False,
        has_actions: bool = True,
        publisher_ids: PublisherIds | None = None,
    ) -> None:
        """Make a tree; raises TransportError for a prefix or a queue that cannot be one.

        Args:
            prefix: the first levels of the standard topics.
            queue: the topic of a source's data.
            is_json: of JSON in place of UADP, which has no probes.
            has_actions: whether Actions are subscribed to.
            publisher_ids: of spaces that have another PublisherId on the wire: it is a level of the standard topics.
        """
        self.publisher_ids = publisher_ids
        self.is_json = is_json
        unheard = {Kind.PROBE, Kind.ANSWER} if is_json else set[Kind]()
        self._heard = [kind for kind in Kind if kind not in unheard and (has_actions or kind not in ACTION_KINDS)]
        for what, text in (("prefix", prefix), ("queue", queue)):
            if problem := _problem(text):
                raise TransportError(f"{what} {text!r}: {problem}")
        self._base = f"{prefix}/{'json' if is_json else 'uadp'}/"
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
        self._remembered = lru_cache(MOST_REMEMBERED)(self._read)

    def queue(self, source: Topic) -> str:
        """Where the data of a DataSetWriter goes."""
        return self._queue.format(topic=source.name, space=source.space, ns=source.ns, id=source.id)

    def topic(self, kind: Kind, publisher: int | str, *names: str) -> str:
        """A topic of the standard tree; `names` are those of a WriterGroup and a DataSetWriter."""
        return "/".join([self._base + kind.value, self.level(publisher), *map(level_of, names)])

    def level(self, publisher: int | str) -> str:
        """The level of a publisher, which inside a process is its space."""
        if self.publisher_ids is None or not isinstance(publisher, int):
            return level_of(str(publisher))
        return level_of(str(self.publisher_ids.variant(publisher).value))

    def filters(self, own: int | None) -> list[str]:
        """What to subscribe to: all that is said, and the requests to one Responder; to all of them for a listener.

        No topic is of two of them, so that none comes twice, and they are few: to a cluster of nats-server a
        subscription of QoS 1 is a group of three that has to choose a leader first, and one that ends in `#` is two.
        """
        found = [f"{self._base}+/+"]  # what is retained comes first
        if Kind.ACTION_REQUEST not in self._heard:  # `+` would bring what is said of Actions
            single = [kind for kind in self._heard if _DEPTHS.get(kind, (1,)) == (1,)]
            found = [f"{self._base}{kind.value}/+" for kind in single]
            found.append(f"{self._base}{Kind.METADATA.value}/+/+/+")
            found.append(f"{self._base}{Kind.DATA.value}/+/+/+")
        else:
            found.append(f"{self._base}+/+/+/+")
            found.append(f"{self._base}{Kind.ACTION_RESPONSE.value}/+/+")
            found.append(f"{self._base}{Kind.ACTION_REQUEST.value}/{'+' if own is None else self.level(own)}/+")
        return found + self.data_filters

    @property
    def data_filters(self) -> list[str]:
        """Those of them that bring nothing but data."""
        return [f"{self._base}{Kind.DATA.value}/+/+", self._queue_filter]

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
        return self._remembered(topic) if len(topic) <= _REMEMBERED_LENGTH else self._read(topic)

    def _read(self, topic: str) -> Place | None:
        if not topic.startswith(self._base):
            return self._read_queue(topic)
        word, *levels = topic[len(self._base) :].split("/")
        try:
            kind = Kind(word)
        except ValueError:
            return None
        if len(levels) not in _DEPTHS.get(kind, (1,)) or not all(map(_is_level, levels)):
            return None
        return None if kind not in self._heard else Place(kind, levels[0], None, tuple(levels[1:]))

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
