"""Hosts, Origins and proxies: whom a request is believed."""

from __future__ import annotations

import pytest

from ua_fleet.console.origins import RequestOrigin, TrustedProxies, is_allowed_host, is_own_origin, source_of

PROXIES = TrustedProxies(["10.0.0.1", "10.1.0.0/16", "::1"])


@pytest.mark.parametrize(
    ("peer", "headers", "expected"),
    [
        (
            "192.0.2.1",
            {"host": "a:1", "x-forwarded-host": "b", "x-forwarded-for": "9.9.9.9"},
            ("192.0.2.1", "http", "a:1"),
        ),
        ("10.0.0.1", {"host": "a", "x-forwarded-host": "B", "x-forwarded-proto": "HTTPS"}, ("10.0.0.1", "https", "b")),
        ("10.0.0.1", {"host": "a", "x-forwarded-for": "9.9.9.9, 192.0.2.7"}, ("192.0.2.7", "http", "a")),
        ("10.0.0.1", {"host": "a", "x-forwarded-for": "192.0.2.7, 10.1.2.3"}, ("192.0.2.7", "http", "a")),
        ("10.0.0.1", {"host": "a", "x-forwarded-for": "192.0.2.7, forged"}, ("10.0.0.1", "http", "a")),
        ("10.0.0.1", {"host": "a", "x-forwarded-proto": "gopher"}, ("10.0.0.1", "http", "a")),
        ("::1", {"host": "a", "x-forwarded-for": "2001:db8::1"}, ("2001:db8::1", "http", "a")),
        ("::ffff:10.0.0.1", {"host": "a", "x-forwarded-for": "192.0.2.7"}, ("192.0.2.7", "http", "a")),
        ("::ffff:10.2.0.1", {"host": "a", "x-forwarded-for": "192.0.2.7"}, ("::ffff:10.2.0.1", "http", "a")),
        ("no address", {}, ("no address", "http", "")),
    ],
)
def test_forwarded_headers_count_from_trusted_proxies_alone(
    peer: str, headers: dict[str, str], expected: tuple[str, str, str]
) -> None:
    assert PROXIES.seen(peer, "http", headers) == RequestOrigin(*expected)


@pytest.mark.parametrize(
    ("host", "allowed", "is_loopback", "expected"),
    [
        ("localhost:8080", [], True, True),
        ("[::1]:8080", [], True, True),
        ("127.0.0.1", [], True, True),
        ("127.0.0.1", [], False, False),
        ("fleet.example:443", ["Fleet.Example"], False, True),
        ("fleet.example.evil", ["fleet.example"], False, False),
        ("evil.example", ["fleet.example"], True, False),
        ("", ["fleet.example"], True, False),
        ("[::1", [], True, False),
        ("[::1]x", [], True, False),
        ("localhost:x", [], True, False),
        ("localhost:80:80", [], True, False),
        ("localhost:", [], True, False),
        ("localhost@evil.example", [], True, False),
    ],
)
def test_hosts(host: str, allowed: list[str], is_loopback: bool, expected: bool) -> None:
    assert is_allowed_host(host, allowed, is_loopback=is_loopback) is expected


def test_an_origin_is_scheme_host_and_port() -> None:
    seen = RequestOrigin("x", "https", "fleet.example:8443")
    assert is_own_origin("https://fleet.example:8443", seen)
    for other in ("http://fleet.example:8443", "https://fleet.example", "null", "", "https://fleet.example:8443.evil"):
        assert not is_own_origin(other, seen)


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::", "2001:db8:1:2::/64"),
        ("::1", "::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("", ""),
    ],
)
def test_who_has_a_network_of_addresses_counts_as_one(address: str, expected: str) -> None:
    assert source_of(address) == expected
