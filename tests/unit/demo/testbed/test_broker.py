"""What the job writes for the broker and its users: a real mosquitto takes it, and refuses everybody else."""

from __future__ import annotations

import asyncio
import base64
import os
import socket
import ssl
import stat
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from ua_demo.testbed import broker as made
from ua_demo.testbed.key_files import KEYS
from ua_demo.testbed.plan import BROKER, BROKER_PORT, SERVER, TESTBEDS, Options
from ua_demo.testbed.prepare import prepare

from tests.integration.mqtt.broker import Broker
from tests.system import free_tcp_port
from ua_fleet.config.load import load
from ua_fleet.endpoint.certificates import list_certificates, load_certificate
from ua_fleet.storage.key_files import KeyFolder

BROKERED = TESTBEDS["brokered"]
NOT_AUTHORIZED = 5
"""Return code of MQTT 3.1.1."""


def prepared(folder: Path) -> None:
    asyncio.run(prepare(BROKERED, folder, Options(), lambda _line: None))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    prepared(folder)
    return folder


def files_of(folder: Path) -> dict[Path, bytes]:
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_second_time_everything_stays(site: Path) -> None:
    before = files_of(site)
    prepared(site)
    assert files_of(site) == before


def test_each_process_has_its_own_password_and_the_keys_that_it_needs(site: Path) -> None:
    keys = {
        name: sorted(path.stem for path in (site / name / KEYS).glob("*.json")) for name in (SERVER, *BROKERED.bridges)
    }
    assert keys == {
        "server": ["c-301", "c-302", "t-0", "t-301", "t-302"],
        "hall_side": ["c-301", "t-0", "t-301"],
        "yard_side": ["c-302", "t-0", "t-302"],
    }
    words = {path.parent.name: path.read_text() for path in site.glob(f"*/{made.PASSWORD}")}
    assert words.keys() == {"server", "yard_side"}, "the hall's bridge is not at the broker"
    assert len(set(words.values())) == 2
    assert {info.bridge for info in list_certificates(site / SERVER)} == {""}, "none of them comes as a client"
    secret = [*site.glob(f"*/{made.PASSWORD}"), *site.glob("*/keys/*"), site / BROKER / made.KEY]
    secret += [site / BROKER / made.USERS, site / BROKER]
    assert {stat.S_IMODE(path.stat().st_mode) & 0o077 for path in secret} == {0}
    for word in words.values():
        assert not [path for path in (site / BROKER).rglob("*") if path.is_file() and word.strip() in path.read_text()]


def test_a_key_that_was_rotated_is_handed_on(tmp_path: Path) -> None:
    prepared(tmp_path)
    folder = KeyFolder(tmp_path / SERVER / KEYS)
    folder.write(folder.read("t-302").rotated(1e9, 60.0, 1))
    prepared(tmp_path)
    handed_on = KeyFolder(tmp_path / "yard_side" / KEYS).read("t-302")
    assert handed_on == folder.read("t-302")
    assert len(handed_on.keys) == 2


def test_a_password_that_was_changed_counts(tmp_path: Path) -> None:
    prepared(tmp_path)
    users = tmp_path / BROKER / made.USERS
    server, yard = users.read_text().splitlines()
    (tmp_path / "yard_side" / made.PASSWORD).write_text("another\n")
    prepared(tmp_path)
    after = users.read_text().splitlines()
    assert after[0] == server
    assert after[1] != yard
    salt = base64.b64decode(after[1].split("$")[3])
    assert after[1] == made.user_line("yard_side", "another", salt)


def test_a_certificate_that_is_soon_over_is_made_anew_for_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(made, "_VALID_DAYS", 20)
        prepared(tmp_path)
    before = (tmp_path / BROKER / made.CERTIFICATE).read_bytes()
    prepared(tmp_path)
    assert (tmp_path / BROKER / made.CERTIFICATE).read_bytes() != before
    authority = (tmp_path / BROKER / made.AUTHORITY).read_bytes()
    assert {(tmp_path / name / made.AUTHORITY).read_bytes() for name in ("server", "yard_side")} == {authority}
    over = load_certificate(tmp_path / BROKER / made.CERTIFICATE).not_valid_after_utc
    assert over > datetime.now(UTC) + timedelta(days=1000)


def test_each_process_writes_its_own_topics_and_the_server_asks(site: Path) -> None:
    users = made.users_at(load(site / "fleet" / "fleet.yaml", BROKERED.environment(SERVER)))
    assert users == {"server": 0, "yard_side": 302}
    server, yard = made.rights_text(users).strip().split("\n\n")
    assert "topic write opcua/uadp/action-request/#" in server
    assert "action-request" not in yard
    assert {line.split()[2].replace("302", "0") for line in yard.splitlines()[2:]} < {
        line.split()[2] for line in server.splitlines()[2:]
    }


@pytest.fixture
def mosquitto(site: Path) -> Iterator[Broker]:
    """The broker with the files of the job, at a free port of loopback."""
    port = free_tcp_port()
    text = (site / BROKER / made.CONFIGURATION).read_text()
    settings = [text.replace(f"listener {BROKER_PORT}", f"listener {port} 127.0.0.1")]
    settings += ["user root\n"] if os.geteuid() == 0 else []
    own = site / "own.conf"
    own.write_text("".join(settings))
    broker = Broker(["mosquitto", "-c", own], port, site / "mosquitto.log")
    broker.start()
    yield broker
    broker.end()


def code_of_connack(site: Path, port: int, user: str, password: str) -> int:
    """What the broker answers to CONNECT of MQTT 3.1.1, over TLS with its authority and its name checked."""
    context = ssl.create_default_context(cafile=site / "yard_side" / made.AUTHORITY)
    words = b"".join(len(word).to_bytes(2, "big") + word.encode() for word in ("test", user, password) if word)
    flags = 0xC2 if user else 0x02
    rest = b"\0\4MQTT\4" + bytes((flags, 0, 60)) + words
    with (
        socket.create_connection(("127.0.0.1", port), 10) as plain,
        context.wrap_socket(plain, server_hostname=BROKER) as link,
    ):
        link.sendall(bytes((0x10, len(rest))) + rest)
        return link.recv(4)[3]


@pytest.mark.needs("mosquitto")
def test_mosquitto_lets_in_whom_the_job_has_named_and_nobody_else(site: Path, mosquitto: Broker) -> None:
    word = (site / "yard_side" / made.PASSWORD).read_text().strip()
    assert code_of_connack(site, mosquitto.port, "yard_side", word) == 0
    assert code_of_connack(site, mosquitto.port, "server", word) == NOT_AUTHORIZED
    assert code_of_connack(site, mosquitto.port, "yard_side", f"{word}x") == NOT_AUTHORIZED
    assert code_of_connack(site, mosquitto.port, "", "") == NOT_AUTHORIZED
