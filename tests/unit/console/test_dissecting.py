"""Messages taken apart for the page."""

from __future__ import annotations

import json

import pytest

from tests.unit.pubsub.security.securing import data, envelope, one
from tests.unit.wire.corpus import valid_messages
from tests.unit.wire.everything import secured_messages
from ua_fleet.console.dissecting import dissected, headline
from ua_fleet.pubsub.security import telemetry_group
from ua_fleet.wire.security import opened_form, read_security


@pytest.mark.parametrize("message", [*valid_messages(), *secured_messages(), b"", b"\xff\xff\xff"])
@pytest.mark.parametrize("is_open", [True, False])
def test_each_byte_stands_in_one_span(message: bytes, is_open: bool) -> None:
    for size in (len(message), len(message) // 2):
        told = dissected(message[:size], is_open=is_open, is_whole=size == len(message))
        at = 0
        for span in told["spans"]:
            assert span["at"] == at
            at += span["size"]
        assert at == size
        json.dumps([told, headline(message[:size])])


def test_an_opened_message_is_decoded_and_a_closed_one_is_not() -> None:
    group = telemetry_group(1)
    sealed = one(envelope(1, group).seal(data("the text"), 0.0))
    opener = envelope(0, group)
    plain = opener.open(sealed, 0.0)
    assert plain is not None
    opened = dissected(opened_form(read_security(sealed), plain), is_open=True, is_whole=True)
    assert opened["error"] == ""
    assert opened["spans"][-2]["text"] == '"the text"'
    assert opened["spans"][-1]["name"] == "Signature"
    closed = dissected(sealed, is_open=False, is_whole=True)
    assert (closed["spans"][-2]["name"], closed["error"]) == ("EncryptedData", "")
    assert headline(sealed, is_open=False) == {"publisher": "1", "group": 2, "writers": [1001], "kind": ""}


def test_what_is_wrong_is_said() -> None:
    told = dissected(data("the text")[:-3], is_open=True, is_whole=True)
    assert "beyond" in told["error"]
    assert told["spans"][-1]["name"] == "NotRead"
    assert dissected(data("the text")[:-3], is_open=True, is_whole=False)["error"] == ""
