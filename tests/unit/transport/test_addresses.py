from __future__ import annotations

import pytest

from ua_fleet.transport.addresses import answer_address

SENDER = ("192.0.2.7", 50_000)


@pytest.mark.parametrize("nothing", [None, ""])
def test_without_a_response_address_the_sender_is_answered(nothing: str | None) -> None:
    assert answer_address(nothing, SENDER) == SENDER


@pytest.mark.parametrize(
    ("response_address", "expected"),
    [
        ("opc.udp://192.0.2.9:4841", ("192.0.2.9", 4841)),
        ("opc.udp://192.0.2.9:4841/", ("192.0.2.9", 4841)),
        ("opc.udp://robot.local:4841", None),
        ("opc.udp://localhost:4841", None),
        ("opc.udp://[::1]:4841", None),
        ("opc.udp://192.0.2.9", None),
        ("opc.udp://192.0.2.9:0", None),
        ("opc.udp://192.0.2.9:99999", None),
        ("opc.udp://192.0.2.9:\u0661\u0662", None),
        ("opc.udp://0192.0.2.9:4841", None),
        ("mqtt://192.0.2.9:4841", None),
        ("opc.udp://0.0.0.0:4841", None),
        ("opc.udp://224.0.2.14:4841", None),
        ("opc.udp://255.255.255.255:4841", None),
        ("opc.udp://127.0.0.1:4841", None),
        ("4841", None),
        ("x" * 10_000, None),
        ("opc.udp://192.0.2.9:" + "9" * 10_000, None),
    ],
)
def test_only_a_literal_address_of_one_host_is_answered(response_address: str, expected: object) -> None:
    assert answer_address(response_address, SENDER) == expected


def test_loopback_may_ask_for_loopback() -> None:
    assert answer_address("opc.udp://127.0.0.1:4841", ("127.0.0.1", 50_000)) == ("127.0.0.1", 4841)


LINK = ("fe80::7%3", 50_000)


@pytest.mark.parametrize(
    ("response_address", "sender", "expected"),
    [
        (None, LINK, LINK),
        ("opc.udp://[fd00::9]:4841", ("fd00::7", 1), ("fd00::9", 4841)),
        ("opc.udp://[::1]:4841", ("::1", 1), ("::1", 4841)),
        ("opc.udp://[::1]:4841", ("fd00::7", 1), None),
        ("opc.udp://[fe80::9]:4841", LINK, ("fe80::9%3", 4841)),
        ("opc.udp://[fe80::9%5]:4841", LINK, None),
        ("opc.udp://[fe80::9]:4841", ("fd00::7", 1), None),
        ("opc.udp://[ff02::1]:4841", LINK, None),
        ("opc.udp://[::]:4841", ("fd00::7", 1), None),
        ("opc.udp://[::ffff:192.0.2.9]:4841", ("fd00::7", 1), None),
        ("opc.udp://192.0.2.9:4841", ("fd00::7", 1), None),
        ("opc.udp://[fd00::9]:4841", SENDER, None),
    ],
)
def test_an_answer_stays_on_its_ip_version_and_its_link(
    response_address: str | None, sender: tuple[str, int], expected: object
) -> None:
    assert answer_address(response_address, sender) == expected
