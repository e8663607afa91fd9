"""`ua-fleet pubsub decode`: exit codes, the table, the JSON, and that a key is never shown."""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import re
import subprocess
import sys
from typing import Any

import pytest

from tests.system import clean_environment
from tests.unit.cli.conftest import Invoke
from tests.unit.wire.corpus import EVERY_TYPE, FULL_METADATA, VECTORS, valid_messages
from tests.unit.wire.discovery_samples import ANNOUNCEMENTS
from tests.unit.wire.everything import ACTIONS
from ua_fleet.values import Variant
from ua_fleet.wire import Codec, encode_metadata_announcement
from ua_fleet.wire.actions import encode_action
from ua_fleet.wire.announcements import TYPES, encode_announcement
from ua_fleet.wire.chunks import split
from ua_fleet.wire.messages import DataSetMessage, FrameKind, MetaDataAnnouncement, NetworkMessage, PublisherIdType
from ua_fleet.wire.security import MessageKey, SecurityMode, SecurityPolicy

KEY_128 = bytes(range(52)).hex()
KEY_256 = bytes(range(68)).hex()
PLAIN = "f101ba08016400014df4 01 0100 0b 0000000000803540"


def vector(name: str, line: int = 0) -> str:
    return (VECTORS / f"{name}.hex").read_text(encoding="ascii").split()[line]


def encoded(part: DataSetMessage, **header: Any) -> str:
    return Codec().encode(NetworkMessage(2, writer_group_id=3, messages=(part,))._replace(**header)).hex()


def objects(stdout: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in stdout.splitlines()]


PEER_FIELDS = [
    {"index": 0, "type": "Double", "value": 21.5},
    {"index": 1, "type": "Int32", "value": 0},
    {"index": 2, "type": "Boolean", "value": True},
    {"index": 3, "type": "DateTime", "value": "2024-01-17T21:20:00Z"},
    {"index": 4, "type": "String", "value": "robot-7"},
]


@pytest.mark.parametrize(
    ("name", "key", "security"),
    [
        ("peer_none", None, {"mode": "None", "token_id": None, "verified": None}),
        ("peer_none", KEY_128, {"mode": "None", "token_id": None, "verified": None}),
        ("peer_sign256", None, {"mode": "Sign", "token_id": 1, "verified": None}),
        ("peer_sign256", KEY_256, {"mode": "Sign", "token_id": 1, "verified": True}),
        ("peer_enc128", KEY_128, {"mode": "SignAndEncrypt", "token_id": 1, "verified": True}),
    ],
)
def test_what_a_peer_sent(name: str, key: str | None, security: dict[str, Any], invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "--json", *(["--key", key] if key else []), vector(name))
    assert ended.code == 0
    (shown,) = objects(ended.stdout)
    assert (shown["publisher_id"], shown["writer_group_id"]) == (2234, 100)
    assert shown["security"] == security
    (message,) = shown["messages"]
    assert (message["data_set_writer_id"], message["kind"], message["fields"]) == (62541, "key", PEER_FIELDS)
    assert "error" not in shown
    assert (ended.stderr == "signed, not verified: no --key was given\n") == (name == "peer_sign256" and key is None)


@pytest.mark.parametrize(
    ("name", "key", "reason"),
    [
        ("peer_enc128", None, "encrypted"),
        ("peer_enc128", KEY_128.replace("00", "ff", 1), "signature"),
        ("peer_sign256", KEY_256.replace("00", "ff", 1), "signature"),
    ],
)
def test_what_cannot_be_trusted_is_not_shown(name: str, key: str | None, reason: str, invoke: Invoke) -> None:
    arguments = [*(["--key", key] if key else []), vector(name)]
    ended = invoke("pubsub", "decode", "--json", *arguments)
    assert ended.code == 1
    assert reason in ended.stderr
    (shown,) = objects(ended.stdout)
    assert shown["messages"] == []
    assert reason in shown["error"]
    assert shown["security"]["verified"] is (None if key is None else False)
    assert (shown["publisher_id"], shown["data_set_writer_ids"]) == (2234, [62541])
    ended = invoke("pubsub", "decode", *arguments)
    assert ended.code == 1
    assert reason in ended.stderr
    assert "SecurityTokenId" in ended.stdout
    assert "robot-7" not in ended.stdout


def test_malformed(invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "--json", PLAIN[:-4])
    assert ended.code == 1
    assert ended.stderr == "truncated at byte 14: 8 bytes needed, 6 left\n"
    assert objects(ended.stdout)[0]["error"] == "truncated at byte 14: 8 bytes needed, 6 left"
    ended = invoke("pubsub", "decode", PLAIN[:-4])
    assert ended.code == 1
    assert "NotRead" in ended.stdout.splitlines()[-1]


def test_one_bad_message_does_not_hide_the_others(invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "--json", PLAIN, "00", PLAIN)
    assert ended.code == 1
    assert ended.stderr == "message 2 of 3: uadp_version at byte 0: version 0\n"
    shown = objects(ended.stdout)
    assert ["error" in message for message in shown] == [False, True, False]
    assert shown[1]["security"] == {"mode": None, "token_id": None, "verified": None}


@pytest.mark.parametrize("text", ["nonsense", "f1 0", "0xf1 zz"])
def test_no_hexadecimal(text: str, invoke: Invoke) -> None:
    for arguments, stdin in (([text], None), (["-"], text)):
        ended = invoke("pubsub", "decode", *arguments, stdin=stdin)
        assert ended.code == 2
        assert "is no hexadecimal" in ended.stderr
        assert ended.stdout == ""


@pytest.mark.parametrize(
    ("key", "said"),
    [(KEY_128[2:], "51 bytes"), ("", "0 bytes"), (KEY_256 + "00", "69 bytes"), ("xyz", "no hexadecimal")],
)
def test_a_wrong_key(key: str, said: str, invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "--key", key, PLAIN)
    assert ended.code == 2
    assert said in ended.stderr
    assert not key or key not in ended.stderr + ended.stdout


@pytest.mark.parametrize("key", [KEY_128, KEY_256])
def test_the_key_is_never_shown(key: str, invoke: Invoke) -> None:
    for name in ("peer_enc128", "peer_sign256"):
        for form in ([], ["--json"]):
            ended = invoke("pubsub", "decode", "--key", key, *form, vector(name))
            assert key not in ended.stdout + ended.stderr
            assert key[:16] not in ended.stdout + ended.stderr


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        PLAIN.replace(" ", ""),
        PLAIN.upper(),
        "0x" + PLAIN,
        " ".join(f"0x{byte:02X}" for byte in bytes.fromhex(PLAIN)),
    ],
)
def test_ways_to_write_bytes(text: str, invoke: Invoke) -> None:
    assert objects(invoke("pubsub", "decode", "--json", text).stdout)[0]["messages"][0]["fields"] == PEER_FIELDS[:1]


def test_lines_of_stdin(invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "--json", "-", stdin=f"{PLAIN}\n\n0x{PLAIN}\n")
    assert ended.code == 0
    assert len(objects(ended.stdout)) == 2


@pytest.mark.parametrize("stdin", ["", "\n \n", "\x00\ufffd\x1b[2J"])
def test_what_is_no_message_on_stdin(stdin: str, invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "-", stdin=stdin)
    assert (ended.code, ended.stdout) == (2, "")
    assert "stdin holds no message" in ended.stderr or "is no hexadecimal" in ended.stderr
    assert "\x1b" not in ended.stderr


def test_the_key_may_stand_in_the_environment(invoke: Invoke, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UA_FLEET_PUBSUB_KEY", KEY_128)
    (shown,) = objects(invoke("pubsub", "decode", "--json", vector("peer_enc128")).stdout)
    assert shown["security"]["verified"] is True


def test_the_other_form_of_a_signed_message(invoke: Invoke) -> None:
    """Table 154 has a token of 0 and no nonce in messages that are only signed."""
    signed = bytes.fromhex("f111ba08016400014df4 01 00000000 00 01 0100 0b 0000000000803540")
    signature = hmac.new(bytes.fromhex(KEY_128)[:32], signed, "sha256").digest()
    (shown,) = objects(invoke("pubsub", "decode", "--json", "--key", KEY_128, (signed + signature).hex()).stdout)
    assert shown["security"] == {"mode": "Sign", "token_id": 0, "verified": True}
    assert shown["messages"][0]["fields"] == PEER_FIELDS[:1]


def test_the_table(invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "--key", KEY_128, vector("peer_enc128"))
    lines = ended.stdout.splitlines()
    assert lines[0] == "96 bytes, SignAndEncrypt, token 1, verified, shown decrypted"
    assert lines[1].split() == ["offset", "length", "bytes", "field", "value"]
    assert "SecurityHeader:" in lines
    rows = [line.split(maxsplit=2) for line in lines]
    assert any(row[:2] == ["24", "1"] and "DataSetFlags1" in row[2] for row in rows)
    assert any("00 00 00 00 00 80 35 40  DataSetFields[0]" in line and line.endswith(" 21.5") for line in lines)
    assert not any("\x1b" in line for line in lines)


@pytest.mark.parametrize("encoded", [pytest.param(data.hex(), id=str(at)) for at, data in enumerate(valid_messages())])
def test_every_kind_of_message_is_shown_in_both_forms(encoded: str, invoke: Invoke) -> None:
    as_table, as_json = invoke("pubsub", "decode", encoded), invoke("pubsub", "decode", "--json", encoded)
    assert as_table.code == as_json.code
    (shown,) = objects(as_json.stdout)
    assert {"publisher_id", "writer_group_id", "security", "messages"} <= set(shown)
    assert ("error" in shown) == (as_json.code == 1)
    assert len(as_table.stdout.splitlines()) > 3


def test_values(invoke: Invoke) -> None:
    types = tuple(value.type for value in EVERY_TYPE)
    values = tuple(value.value for value in EVERY_TYPE)
    (shown,) = objects(
        invoke("pubsub", "decode", "--json", encoded(DataSetMessage(1, types=types, values=values))).stdout
    )
    by_type = {field["type"]: field["value"] for field in shown["messages"][0]["fields"]}
    assert by_type["Null"] is None
    assert by_type["DateTime"] == "2024-01-17T21:20:00Z"
    assert by_type["Guid"] == "72962b91-fa75-4ae6-8d28-b404dc7daf63"
    assert by_type["ByteString"] == "AP8="
    assert by_type["NodeId"] == "ns=2;s=robot"
    assert by_type["StatusCode"] == "BadNoCommunication"
    assert by_type["LocalizedText"] == {"locale": "en", "text": "text"}
    assert by_type["ExtensionObject"] == {"type_id": "ns=2;i=70000", "body": "Ym9keQ=="}
    assert by_type["DataValue"]["value"] == "x"
    assert by_type["DiagnosticInfo"]["inner"]["symbolic_id"] == 6
    assert by_type["Double[]"] == [1.0, 2.0, 3.0]
    assert by_type["String[]"] == ["a", None, "bc"]
    assert by_type["Variant[]"] == [{"type": "Byte", "value": 1}, {"type": "String[]", "value": ["x"]}]
    assert by_type["Int32[][]"] == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("variant", "shown"),
    [
        (Variant(11, float("nan")), "NaN"),
        (Variant(10, float("-inf")), "-Infinity"),
        (Variant(0x8B, (1.0, float("inf"))), [1.0, "Infinity"]),
        (Variant(9, 2**64 - 1), 2**64 - 1),
        (Variant(19, 0x8031_0001), "0x80310001"),
        (Variant(13, 133_500_000_000_000_001), "2024-01-17T21:20:00.0000001Z"),
        (Variant(13, 0), "1601-01-01T00:00:00Z"),
        (Variant(12, "a\x1b[2J\x9b2J\x7f"), "a\x1b[2J\x9b2J\x7f"),
        (Variant(15, None), None),
        (Variant(0x86, None), None),
    ],
)
def test_values_that_json_does_not_have(variant: Variant, shown: Any, invoke: Invoke) -> None:
    ended = invoke(
        "pubsub", "decode", "--json", encoded(DataSetMessage(1, types=(variant.type,), values=(variant.value,)))
    )
    assert objects(ended.stdout)[0]["messages"][0]["fields"][0]["value"] == shown
    assert not re.search("[\x1b\x7f-\x9f]", ended.stdout)


def test_dimensions_of_nothing(invoke: Invoke) -> None:
    ended = invoke("pubsub", "decode", "--json", "f101ba08016400014df4 01 0100 c3 00000000 02000000 ffffff7f 00000000")
    assert objects(ended.stdout)[0]["messages"][0]["fields"] == [{"index": 0, "type": "Byte[][]", "value": []}]


def test_kinds_and_their_headers(invoke: Invoke) -> None:
    delta = DataSetMessage(
        1, FrameKind.DELTA, (11,), (2.5,), indices=(3,), sequence_number=6, timestamp=0, status=0x8031_0000
    )
    shown = objects(
        invoke(
            "pubsub",
            "decode",
            "--json",
            encoded(delta),
            encoded(DataSetMessage(1, FrameKind.KEEP_ALIVE, sequence_number=8)),
            encoded(DataSetMessage(1, FrameKind.EVENT, (12,), ("x",))),
            encoded(DataSetMessage(1, valid=False)),
            vector("peer_raw"),
            vector("peer_datavalue"),
        ).stdout
    )
    messages = [shown_one["messages"][0] for shown_one in shown]
    assert [message["kind"] for message in messages] == ["delta", "keep-alive", "event", "key", "key", "key"]
    assert messages[0]["fields"] == [{"index": 3, "type": "Double", "value": 2.5}]
    assert (messages[0]["status"], messages[0]["sequence_number"]) == ("BadNoCommunication", 6)
    assert messages[3]["valid"] is False
    assert messages[4]["fields"] == []
    assert messages[4]["raw"].startswith("0000000000803540")
    assert messages[5]["fields"][0]["source_timestamp"].startswith("2026-11-21T")
    assert messages[5]["fields"][0]["status"] == "Good"


def test_probes_and_announcements(invoke: Invoke) -> None:
    announced = encode_metadata_announcement(MetaDataAnnouncement(2, PublisherIdType.UINT16, 7, 1001, FULL_METADATA))
    probe = "91910407000000000000000102010000000100"
    shown = objects(invoke("pubsub", "decode", "--json", probe, announced.hex()).stdout)
    assert shown[0]["probe"].items() >= {"information_type": 2, "asks_for": "DataSetMetaData"}.items()
    assert shown[0]["probe"]["data_set_writer_ids"] == [1]
    announcement = shown[1]["announcement"]
    assert (announcement["announcement_type"], announcement["sequence_number"]) == (2, 7)
    assert [field["name"] for field in announcement["metadata"]["fields"]] == ["linear.x", "name"]


@pytest.mark.parametrize("name", ANNOUNCEMENTS)
def test_announcements_of_every_kind(name: str, invoke: Invoke) -> None:
    datagram = encode_announcement(ANNOUNCEMENTS[name])
    ended = invoke("pubsub", "decode", "--json", datagram.hex())
    assert (ended.code, ended.stderr) == (0, "")
    announcement = objects(ended.stdout)[0]["announcement"]
    assert announcement["announcement_type"] == TYPES.get(type(ANNOUNCEMENTS[name]), 5)
    assert announcement["sequence_number"] == ANNOUNCEMENTS[name].sequence_number
    assert len(announcement) > 3


def test_parts_of_announcements(invoke: Invoke) -> None:
    def of(name: str) -> Any:
        return objects(invoke("pubsub", "decode", "--json", encode_announcement(ANNOUNCEMENTS[name]).hex()).stdout)[0][
            "announcement"
        ]

    assert of("cyclic status")["next_report_time"] == "2024-01-17T21:20:00.0000001Z"
    assert of("writers")["statuses"] == ["Good", "BadNotFound"]
    assert of("writers")["writer_group"]["data_set_writers"][0]["data_set_writer_id"] == 1001
    assert of("endpoints")["endpoints"][0]["server_certificate"] == "AQID"
    assert of("actions")["targets"][0]["name"] == "gripper"
    assert of("actions")["response"]["fields"][0]["name"] == "linear.x"


def test_actions(invoke: Invoke) -> None:
    shown = objects(invoke("pubsub", "decode", "--json", *[encode_action(action).hex() for action in ACTIONS]).stdout)
    assert [message["kind"] for message in shown[0]["messages"]] == ["action-request"]
    assert shown[0]["action"] == {
        "requestor_id": "0.1",
        "correlation_data": "AAECAwQFBgcICQoLDA0ODw==",
        "response_address": None,
        "timeout_hint_ms": 500.0,
    }
    request = shown[0]["messages"][0]
    assert (request["action_target_id"], request["request_id"], request["action_state"]) == (1, 7, "Executing")
    assert request["fields"][0] == {"index": 0, "type": "String", "value": "pick"}
    assert [message["request_id"] for message in shown[2]["messages"]] == [7, 8]
    assert (shown[4]["messages"][0]["kind"], shown[4]["messages"][0]["status"]) == (
        "action-response",
        "BadNoCommunication",
    )


def test_chunks_are_put_together(invoke: Invoke) -> None:
    text = "text " * 100
    whole = bytes.fromhex(encoded(DataSetMessage(1, types=(12,), values=(text,))))
    chunks = [chunk.hex() for chunk in split(whole, 200, 5)]
    assert len(chunks) > 2
    ended = invoke("pubsub", "decode", "--json", *reversed(chunks))
    assert (ended.code, ended.stderr) == (0, "")
    *others, last = objects(ended.stdout)
    assert all(shown["messages"] == [] and not shown["chunk"]["complete"] for shown in others)
    assert last["chunk"]["complete"]
    assert last["messages"][0]["fields"] == [{"index": 0, "type": "String", "value": text}]
    ended = invoke("pubsub", "decode", *chunks)
    assert f"put together: {len(whole)} bytes" in ended.stdout
    ended = invoke("pubsub", "decode", chunks[0])
    assert (ended.code, ended.stderr) == (0, "chunks are missing of 1 message\n")


def test_chunks_that_do_not_fit_together(invoke: Invoke) -> None:
    head = "d1810107004df4 0300"
    first, other = head + "00000000 0c000000 06000000 0101000b0000", head + "04000000 0c000000 04000000 00000000"
    ended = invoke("pubsub", "decode", "--json", first, first, other)
    assert ended.code == 1
    assert "message 3 of 3: chunk_overlaps" in ended.stderr
    assert ["error" in shown for shown in objects(ended.stdout)] == [False, False, True]


def test_a_duplicate_of_a_chunk_that_is_no_longer_missing(invoke: Invoke) -> None:
    whole = bytes.fromhex(encoded(DataSetMessage(1, types=(12,), values=("text " * 100,))))
    chunks = [chunk.hex() for chunk in split(whole, 300, 5)]
    ended = invoke("pubsub", "decode", "--json", *chunks, chunks[0])
    assert (ended.code, ended.stderr) == (0, "")


@pytest.mark.parametrize("mode", [SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT])
def test_a_mistake_inside_what_was_encrypted_has_the_offset_of_the_datagram(mode: SecurityMode, invoke: Invoke) -> None:
    key = MessageKey(SecurityPolicy.AES128_CTR, bytes.fromhex(KEY_128))
    plain = bytes.fromhex("f101ba08016400014df4 01 0100 0c 05000000 61")
    secured = key.protect(plain, 10, 1, bytes(8), mode)
    ended = invoke("pubsub", "decode", "--key", KEY_128, secured.hex())
    assert ended.code == 1
    assert ended.stderr == f"length_beyond_end at byte {14 + 14}: 5 elements announced, 1 bytes left\n"
    last = [line for line in ended.stdout.splitlines() if "NotRead" in line]
    assert last[0].split()[:2] == ["28", "5"]


def test_on_a_terminal_the_same_is_shown() -> None:
    command = [sys.executable, "-m", "ua_fleet.cli", "pubsub", "decode", PLAIN]
    piped = subprocess.run(command, capture_output=True, check=True, env=clean_environment()).stdout
    leader, follower = os.openpty()
    with subprocess.Popen(command, stdout=follower, env=clean_environment()) as child:
        os.close(follower)
        shown = b""
        with contextlib.suppress(OSError):  # the other side is closed
            while more := os.read(leader, 65_536):
                shown += more
        os.close(leader)
    assert child.returncode == 0
    assert shown.replace(b"\r\n", b"\n") == piped
