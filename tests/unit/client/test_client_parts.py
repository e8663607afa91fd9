"""Addresses, conversion of texts and the client's identity: what needs no server."""

from __future__ import annotations

import json
import math
import stat
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua

from ua_fleet.client.addresses import parse_address
from ua_fleet.client.convert import parse_value, plain_value
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.errors import AccessRefused
from ua_fleet.values import StatusCode


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("ns=2;i=1001", "ns=2;i=1001"),
        ("i=85", "i=85"),
        ("ns=2;s=1005.header.frame_id", "ns=2;s=1005.header.frame_id"),
        ("ua_1_2_1001", "ns=2;i=1001"),
        ("ua_232_7_65535", "ns=7;i=65535"),
        ("Fleet/Robots/ned", ("Fleet", "Robots", "ned")),
        ("Objects/Fleet", ("Fleet",)),
        ("/Fleet/", ("Fleet",)),
        ("Objects", ()),
        ("ua_1_2", ("ua_1_2",)),
    ],
)
def test_addresses(text: str, address: str | tuple[str, ...]) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("true", ua.VariantType.Boolean, True),
        ("Off", ua.VariantType.Boolean, False),
        ("-128", ua.VariantType.SByte, -128),
        ("0xff", ua.VariantType.Byte, 255),
        ("65535", ua.VariantType.UInt16, 65535),
        ("1e3", ua.VariantType.Double, 1000.0),
        ("text, as it is", ua.VariantType.String, "text, as it is"),
        ("2026-01-02T03:04:05+00:00", ua.VariantType.DateTime, datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)),
        ("00ff", ua.VariantType.ByteString, b"\x00\xff"),
    ],
)
def test_a_text_becomes_a_value_of_the_nodes_type(text: str, kind: ua.VariantType, value: Any) -> None:
    variant = parse_value(text, kind, array=False)
    assert (variant.Value, variant.VariantType) == (value, kind)


def test_an_array_is_json() -> None:
    variant = parse_value("[1, 2.5]", ua.VariantType.Double, array=True)
    assert (variant.Value, variant.is_array) == ([1.0, 2.5], True)


@pytest.mark.parametrize(
    ("text", "kind", "array"),
    [
        ("maybe", ua.VariantType.Boolean, False),
        ("256", ua.VariantType.Byte, False),
        ("1.5", ua.VariantType.Int32, False),
        ("xyz", ua.VariantType.ByteString, False),
        ("1", ua.VariantType.Double, True),
        ('{"a": 1}', ua.VariantType.Double, True),
        ("[1, true]", ua.VariantType.Int32, True),
    ],
)
def test_a_text_that_is_no_such_value_is_refused(text: str, kind: ua.VariantType, array: bool) -> None:
    with pytest.raises(AccessRefused, match=kind.name) as refused:
        parse_value(text, kind, array=array)
    assert refused.value.ua_status == StatusCode.BAD_TYPE_MISMATCH


def test_values_become_what_json_can_hold() -> None:
    moment = datetime(2026, 1, 2, tzinfo=UTC)
    plain = plain_value([1, math.nan, b"\x01", moment, ua.LocalizedText("hello"), None])
    assert plain == [1, "nan", "01", "2026-01-02T00:00:00+00:00", "hello", None]
    assert json.loads(json.dumps(plain)) == plain


async def test_the_client_makes_its_certificate_once_and_keeps_the_key_to_itself(tmp_path: Path) -> None:
    identity = ClientIdentity(tmp_path / "client")
    await identity.ensure()
    made = identity.certificate.read_bytes()
    await identity.ensure()
    assert identity.certificate.read_bytes() == made
    assert stat.S_IMODE(identity.key.stat().st_mode) == 0o600


def test_a_server_is_trusted_on_first_use_and_held_to_it(tmp_path: Path) -> None:
    identity = ClientIdentity(tmp_path)
    endpoint = "opc.tcp://127.0.0.1:4840/ua_fleet"
    assert identity.check_server(endpoint, b"one")
    assert not ClientIdentity(tmp_path).check_server(endpoint, b"one")
    with pytest.raises(AccessRefused, match="another certificate"):
        identity.check_server(endpoint, b"two")
