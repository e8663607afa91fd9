"""Addresses, conversion of texts and the client's identity: what needs no server."""

from __future__ import annotations

import errno
import json
import math
import re
import socket
import stat
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from tests.integration.server_security.harness import load, make_certificate
from ua_fleet.client.addresses import parse_address
from ua_fleet.client.convert import parse_value, plain_value
from ua_fleet.client.fleet_client import Reading
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.client.model_changes import ModelChanges
from ua_fleet.client.subscriptions import Feed
from ua_fleet.client.translated import translated
from ua_fleet.endpoint.certificates import CertificateFiles
from ua_fleet.errors import AccessRefused, NotConnected
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


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("1600-12-31T23:59:59Z", ua.VariantType.DateTime, "goes from 1601-01-01T00:00:00Z to 9999-12-31T23:59:59Z"),
        ("1500-01-01", ua.VariantType.DateTime, "goes from"),
        ("1601-01-01T00:30:00+01:00", ua.VariantType.DateTime, "goes from"),
        ("0001-01-01T00:00:00+10:00", ua.VariantType.DateTime, "goes from"),
        ("9999-12-31T23:59:59.5Z", ua.VariantType.DateTime, "goes from"),
        ("9999-12-31T23:59:59-05:00", ua.VariantType.DateTime, "goes from"),
        ("10000-01-01T00:00:00Z", ua.VariantType.DateTime, "give a time like"),
        ("1e999", ua.VariantType.Double, "too large"),
        ("-1e999", ua.VariantType.Double, "too large"),
        ("9" * 400, ua.VariantType.Double, "too large"),
        ("1e39", ua.VariantType.Float, "too large"),
        ("-3.4028236e38", ua.VariantType.Float, "too large"),
        ("1e-400", ua.VariantType.Double, "too small"),
        ("-0.1e-60", ua.VariantType.Float, "too small"),
        ("-129", ua.VariantType.SByte, "goes from -128 to 127"),
        ("nan", ua.VariantType.Int32, "whole number"),
        ("", ua.VariantType.Double, "give a number"),
        ("", ua.VariantType.Int64, "whole number"),
        ("", ua.VariantType.Boolean, "true or false"),
        ("", ua.VariantType.DateTime, "give a time"),
    ],
)
def test_what_would_become_another_value_is_refused(text: str, kind: ua.VariantType, said: str) -> None:
    for given, array in ((text, False), (json.dumps([text]), True)):
        with pytest.raises(AccessRefused, match=said) as refused:
            parse_value(given, kind, array=array)
        assert refused.value.ua_status == StatusCode.BAD_TYPE_MISMATCH


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("1601-01-01T00:00:00Z", ua.VariantType.DateTime, datetime(1601, 1, 1, tzinfo=UTC)),
        ("9999-12-31T23:59:59Z", ua.VariantType.DateTime, datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)),
        ("2026-01-02T03:04:05+02:00", ua.VariantType.DateTime, datetime(2026, 1, 2, 1, 4, 5, tzinfo=UTC)),
        ("2026-01-02", ua.VariantType.DateTime, datetime(2026, 1, 2, tzinfo=UTC)),
        ("inf", ua.VariantType.Double, math.inf),
        ("-Infinity", ua.VariantType.Float, -math.inf),
        ("3.4028235e38", ua.VariantType.Float, 3.4028235e38),
        ("0e-999", ua.VariantType.Float, 0.0),
        ("-0.0", ua.VariantType.Double, 0.0),
    ],
)
def test_what_a_type_can_hold_is_taken(text: str, kind: ua.VariantType, value: Any) -> None:
    assert parse_value(text, kind, array=False).Value == value


def test_not_a_number_is_what_was_written() -> None:
    assert math.isnan(parse_value("nan", ua.VariantType.Double, array=False).Value)
    numbers = parse_value("[NaN, -Infinity]", ua.VariantType.Double, array=True).Value
    assert (math.isnan(numbers[0]), numbers[1]) == (True, -math.inf)


@pytest.mark.parametrize("text", ["[null]", "[[1]]", '["a", {"b": 1}]'])
def test_what_is_no_single_value_is_no_text_of_an_array(text: str) -> None:
    with pytest.raises(AccessRefused, match="single values"):
        parse_value(text, ua.VariantType.String, array=True)


def test_numbers_among_texts_stay_as_they_are_written() -> None:
    assert parse_value('["a", 1e2, 1.50]', ua.VariantType.String, array=True).Value == ["a", "1e2", "1.50"]


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


async def test_a_key_that_others_can_read_or_that_is_none_is_said(tmp_path: Path) -> None:
    identity = ClientIdentity.of_bridge(tmp_path, "Fleet", "cell")
    await identity.ensure()
    assert (identity.certificate.name, identity.key.name) == ("bridge.der", "bridge-key.pem")
    certificate = x509.load_der_x509_certificate(identity.certificate.read_bytes())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.UniformResourceIdentifier) == ["urn:ua-fleet:Fleet:bridge:cell"]
    assert certificate.subject.rfc4514_string() == "O=ua-fleet,CN=ua-fleet bridge cell"
    identity.key.chmod(0o640)
    with pytest.raises(AccessRefused, match=f"chmod 600 {identity.key}"):
        await identity.ensure()
    identity.key.chmod(0o600)
    identity.key.write_text("-----BEGIN PRIVATE KEY-----\nsecret\n-----END PRIVATE KEY-----\n")
    with pytest.raises(AccessRefused, match="no readable key") as refused:
        await identity.ensure()
    assert "secret" not in str(refused.value)
    assert refused.value.__suppress_context__


async def test_an_identity_keeps_its_uri_when_the_host_is_renamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = ClientIdentity(tmp_path)
    await first.ensure()
    monkeypatch.setattr(socket, "gethostname", lambda: "another-name")
    second = ClientIdentity(tmp_path)
    assert second.application_uri != first.application_uri
    await second.ensure()
    assert second.application_uri == first.application_uri


async def test_an_expired_certificate_is_made_anew_and_a_broken_one_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    identity = ClientIdentity(tmp_path)
    await identity.ensure()
    made = identity.certificate.read_bytes()
    end = x509.load_der_x509_certificate(made).not_valid_after_utc

    class Later(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Later:
            return cls.fromtimestamp(end.timestamp() + 1, tz)

    monkeypatch.setattr("ua_fleet.client.identity.datetime", Later)
    await identity.ensure()
    assert identity.certificate.read_bytes() != made
    identity.certificate.write_bytes(b"no certificate")
    with pytest.raises(AccessRefused, match=r"no readable certificate .*; remove it, and another one is made"):
        await identity.ensure()


def put(identity: ClientIdentity, made: CertificateFiles) -> None:
    """Let an identity have a certificate that was made for it."""
    identity.folder.mkdir(exist_ok=True)
    for source, target in ((made.certificate, identity.certificate), (made.private_key, identity.key)):
        target.write_bytes(source.read_bytes())
        target.chmod(0o600)


async def test_a_bridges_certificate_that_has_ended_is_renewed_by_command_and_with_its_key(tmp_path: Path) -> None:
    identity = ClientIdentity.of_bridge(tmp_path / "cell", "Hall", "cell")
    put(identity, make_certificate(tmp_path, "cell", uri=identity.application_uri, days=(-30, -1)))
    key, file = identity.key.read_bytes(), identity.key.stat().st_ino
    with pytest.raises(AccessRefused) as refused:
        await identity.ensure()
    assert re.fullmatch(
        rf"{identity.certificate}: expired on 20..-..-..; run: ua-fleet cert create --bridge cell --renew, and on the "
        rf"server: ua-fleet cert trust --bridge cell {identity.certificate}",
        str(refused.value),
    )
    await identity.renew()
    await identity.ensure()
    assert (identity.key.read_bytes(), identity.key.stat().st_ino) == (key, file)
    certificate = x509.load_der_x509_certificate(identity.certificate.read_bytes())
    assert certificate.public_key() == load_pem_private_key(key, password=None).public_key()
    put(identity, make_certificate(tmp_path, "early", uri=identity.application_uri, days=(1, 30)))
    with pytest.raises(AccessRefused, match=r"is valid only from .* UTC; check the clock of this machine"):
        await identity.ensure()


async def test_a_cas_certificate_is_not_replaced(tmp_path: Path) -> None:
    authority = load(make_certificate(tmp_path, "ca", ca=True))
    identity = ClientIdentity(tmp_path / "client")
    put(identity, make_certificate(tmp_path, "mine", issuer=authority, days=(-30, -1)))
    before = identity.certificate.read_bytes()
    with pytest.raises(AccessRefused, match=r"expired on .*; have its CA issue another one, and put it there"):
        await identity.ensure()
    with pytest.raises(AccessRefused, match=r"was issued by CN=ca; have that CA renew it"):
        await identity.renew()
    assert identity.certificate.read_bytes() == before


@pytest.mark.parametrize(
    ("days", "said"),
    [
        ((-30, -1), "expired on .*; on the server run: ua-fleet cert create --renew, and restart it"),
        ((1, 30), "is valid only from .*; check the clocks of both machines"),
    ],
)
def test_a_server_that_may_not_show_its_certificate(tmp_path: Path, days: tuple[int, int], said: str) -> None:
    certificate = make_certificate(tmp_path, "server", days=days).certificate.read_bytes()
    identity = ClientIdentity(tmp_path)
    with pytest.raises(AccessRefused, match=f"the certificate of the server at opc.tcp://x {said}"):
        identity.check_server("opc.tcp://x", certificate)
    identity.pinned_server.write_bytes(certificate)
    with pytest.raises(AccessRefused, match=said):
        identity.check_server("opc.tcp://x", certificate)
    assert not (tmp_path / "servers.json").exists()


async def test_a_slow_consumer_loses_the_oldest_changes_and_hears_the_end() -> None:
    feed = Feed[Reading](3)
    for number in range(5):
        feed.put(Reading("i=1", number, "Int32", 0, None, None))
    feed.lose()
    seen: list[Any] = []
    while (change := await feed.next()) is not None:
        seen.append(change.value)
    assert seen == [3, 4]
    assert feed.dropped == 3


async def test_what_comes_after_the_end_does_not_hide_it() -> None:
    """asyncua may hand on what it had before the connection was lost."""
    changes = ModelChanges("opc.tcp://x")
    changes.lose()
    changes.event_notification(None)
    for _ in range(2):
        with pytest.raises(NotConnected):
            await changes.wait()


@pytest.mark.parametrize(
    ("status", "name"), [(0, "Good"), (0x80310000, "BadNoCommunication"), (0x80350000, "BadAttributeIdInvalid")]
)
def test_every_status_has_its_name(status: int, name: str) -> None:
    assert Reading("i=1", None, None, status, None, None).status_text == name


def test_a_number_that_is_none_is_said_with_the_remedy() -> None:
    for kind, hint in ((ua.VariantType.Int32, "give a whole number"), (ua.VariantType.DateTime, "give a time like")):
        with pytest.raises(AccessRefused, match=hint):
            parse_value("soon", kind, array=False)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ECONNREFUSED, "Connect call failed ('127.0.0.1', 4840)"), " (connection refused)"),
        (OSError(errno.EHOSTUNREACH, "Connect call failed ('10.0.0.9', 4840)"), " (no route to host)"),
        (OSError("Multiple exceptions: [Errno 111] Connect call failed ('::1', 4840, 0, 0), ..."), ""),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), " (name or service not known)"),
    ],
)
def test_a_server_that_does_not_answer_is_said_in_words(error: OSError, said: str) -> None:
    with pytest.raises(NotConnected) as told, translated("opc.tcp://10.0.0.9:4840/ua_fleet"):
        raise error
    assert str(told.value) == f"the server at 10.0.0.9:4840 does not answer{said}; start it with: ua-fleet serve"
