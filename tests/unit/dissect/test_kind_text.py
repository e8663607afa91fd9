"""Kinds of messages in words, against what the codec makes of them."""

from __future__ import annotations

import random

import pytest

from tests.unit.wire.corpus import valid_messages
from tests.unit.wire.discovery_samples import ANNOUNCEMENTS
from tests.unit.wire.everything import chunked_messages, is_plain, plain_messages, secured_messages
from ua_fleet.dissect.kind_text import kind_text
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.announcements import encode_announcement
from ua_fleet.wire.messages import FrameKind, NetworkMessage, Probe

KINDS = {
    FrameKind.KEY: "key frame",
    FrameKind.DELTA: "delta frame",
    FrameKind.EVENT: "event",
    FrameKind.KEEP_ALIVE: "keep-alive",
}


@pytest.mark.parametrize("datagram", [one for one in [*valid_messages(), *plain_messages()] if is_plain(one)])
def test_it_is_what_the_codec_says(datagram: bytes) -> None:
    message = Codec().decode(datagram)
    told = kind_text(datagram)
    if isinstance(message, NetworkMessage):
        first = message.messages[0]
        assert told == (KINDS[FrameKind(first.kind)] if first.valid else "not valid")
    elif isinstance(message, ActionMessage):
        assert told == ("Action request" if message.is_request else "Action response")
    elif isinstance(message, Probe):
        assert told.startswith("probe: ")
    else:
        assert told.startswith("announcement: ")


@pytest.mark.parametrize("name", list(ANNOUNCEMENTS))
def test_announcements(name: str) -> None:
    assert kind_text(encode_announcement(ANNOUNCEMENTS[name])).startswith("announcement: ")


def test_a_part_is_a_chunk() -> None:
    assert {kind_text(one) for one in chunked_messages()} == {"chunk"}


def test_it_takes_any_bytes() -> None:
    chance = random.Random(5)
    whole = [*plain_messages(), *secured_messages()]
    for datagram in whole:
        for size in range(len(datagram)):
            kind_text(datagram[:size])
    for _ in range(3000):
        message = bytearray(chance.choice(whole))
        message[chance.randrange(len(message))] = chance.randrange(256)
        kind_text(bytes(message))
    assert kind_text(b"") == ""
    assert kind_text(b"\x01\x00") == "not valid"
