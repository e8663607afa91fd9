"""Where the key of a context goes, and where it does not."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from ua_fleet.cli.context_file import ContextFile, LoginContext
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import ConnectionOptions
from ua_fleet.client import AnotherServer, FleetClient

ENDPOINT = "opc.tcp://127.0.0.1:1/ua_fleet"
URI = "urn:ua-fleet:hall:server"


@pytest.fixture
def contexts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ContextFile:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv("PYTHON_KEYRING_BACKEND", "keyring.backends.null.Keyring")
    return ContextFile()


def context(server_uri: str, *, insecure: bool) -> LoginContext:
    until = datetime(2030, 1, 31, tzinfo=UTC)
    return LoginContext("hall", ENDPOINT, "anna", server_uri, "Basic256Sha256", insecure, "1f", until, "key")


def connection(*, insecure: bool) -> ConnectionOptions:
    return ConnectionOptions.of(None, None, None, None, None, insecure, 1.0)


def test_the_key_of_a_server_that_is_known_is_not_given_to_whoever_answers(contexts: ContextFile) -> None:
    contexts.put(context(URI, insecure=False), "key")
    assert connection(insecure=False).server_uri == URI
    with pytest.raises(UsageError, match="--insecure would give it to whoever answers"):
        connection(insecure=True)
    contexts.put(context("", insecure=True), "key")
    assert connection(insecure=False).insecure


def test_two_logins_at_once_get_a_name_each(contexts: ContextFile) -> None:
    """Neither of them has seen the other's context when it asks the server for its key."""
    anna = replace(context(URI, insecure=False), name="")
    first, before = contexts.put(anna, "key")
    assert (first.name, before) == ("hall", None)
    second, before = contexts.put(replace(anna, user="eva", key_id="2f"), "key 2")
    assert (second.name, before) == ("hall-eva", None)
    renewed, before = contexts.put(replace(anna, key_id="3f"), "key 3")
    assert (renewed.name, before) == ("hall", first)
    assert [(one.name, one.user) for one in contexts.load().all] == [("hall", "anna"), ("hall-eva", "eva")]


async def test_a_client_without_security_does_not_ask_a_server_who_it_is(contexts: ContextFile) -> None:
    del contexts
    with pytest.raises(AnotherServer):
        async with FleetClient.connect(ENDPOINT, user="anna", password="key", insecure=True, server_uri=URI):
            pass


def test_a_policy_that_there_is_not_is_told(contexts: ContextFile) -> None:
    contexts.put(context(URI, insecure=False), "key")
    contexts.path.write_text(contexts.path.read_text().replace("Basic256Sha256", "Basic128Rsa15"))
    with pytest.raises(UsageError, match=r"Basic128Rsa15.*remove it, and log in again"):
        connection(insecure=False)
