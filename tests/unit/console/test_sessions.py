"""Sessions of browsers, and how often somebody may try: with time as an argument."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from ua_fleet.console.attempts import Attempts
from ua_fleet.console.sessions import BrowserSessions
from ua_fleet.console.settings import ConsoleSettings, split_listen


def test_a_session_ends_idle_or_old_and_is_kept_as_a_hash() -> None:
    sessions = BrowserSessions(idle_s=100, longest_s=250, most=2)
    begun = sessions.begin(0.0)
    assert begun is not None
    session, token = begun
    assert token not in repr(vars(sessions)) + repr(session)
    assert session.csrf not in repr(session)
    assert sessions.find(token, 99) is session
    assert sessions.find(token + "x", 1) is None
    assert sessions.find("", 1) is None
    sessions.use(session, 90)
    assert sessions.find(token, 189) is session
    assert sessions.find(token, 190) is None
    sessions.use(session, 240)
    assert sessions.find(token, 249) is session
    assert (sessions.find(token, 250), sessions.expired(250)) == (None, [session])
    assert sessions.begin(0.0) is not None
    assert sessions.begin(0.0) is None, "there are as many as there may be"
    sessions.end(session)
    assert sessions.find(token, 241) is None
    assert session.is_csrf(session.csrf)
    assert not session.is_csrf("")


@given(st.lists(st.floats(0, 30), max_size=60))
def test_never_more_than_the_bucket_and_its_refill(pauses: list[float]) -> None:
    attempts, now, made = Attempts(4, 15.0), 0.0, list[float]()
    for pause in pauses:
        now += pause
        if attempts.wait_s("anna", now) == 0:
            attempts.count("anna", now)
            made.append(now)
    for at, began in enumerate(made):
        for number, ended in enumerate(made[at:], 1):
            assert number <= 4 + (ended - began) / 15.0 + 1e-6


def test_an_attempt_that_did_not_fail_costs_nothing_and_names_are_bounded() -> None:
    attempts = Attempts(1, 10.0, most=3)
    attempts.count("anna", 0.0)
    assert attempts.wait_s("anna", 0.0) == 10.0
    attempts.forgive("anna")
    assert attempts.wait_s("anna", 0.0) == 0.0
    for number in range(100):
        attempts.count(str(number), 0.0)
    assert len(attempts) == 3


@pytest.mark.parametrize("listen", ["", "8080", "localhost", "localhost:x", "localhost:99999", ":-1"])
def test_what_is_no_address_is_refused(listen: str) -> None:
    with pytest.raises(ValueError, match="is no address and port"):
        split_listen(listen)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"fleets": {}}, "fleets"),
        ({"fleets": {"a b": {"endpoint": "opc.tcp://x"}}}, "no name of a fleet"),
        ({"fleets": {"a": {"endpoint": "http://x"}}}, "endpoint"),
        ({"listen": "0.0.0.0:80"}, "allowed_hosts is missing"),
        ({"listen": "0.0.0.0:80", "allowed_hosts": ["x"]}, "tls is missing"),
        ({"trusted_proxies": ["proxy.example"]}, "trusted_proxies"),
        ({"unknown": 1}, "unknown"),
    ],
)
def test_settings_that_are_mistaken_or_weak_are_refused(given: dict[str, object], said: str) -> None:
    whole = {"fleets": {"hall": {"endpoint": "opc.tcp://127.0.0.1:4840"}}, **given}
    with pytest.raises(ValidationError, match=said):
        ConsoleSettings.model_validate(whole)
