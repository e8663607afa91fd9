from __future__ import annotations

import pytest

from ua_fleet.endpoint.audit.syslog_message import Destination, Origin, encode_message, frame_message, parse_destination

PLANT = Origin("plant-7", 4711)


def test_a_message_of_rfc_5424() -> None:
    message = encode_message(
        b'{"event": "login"}', time="2026-01-31T12:00:00.123Z", event="login", refused=False, origin=PLANT
    )
    # PRI is facility 13 times 8 and severity 6, VERSION is 1; structured data there is none.
    assert message == b'<110>1 2026-01-31T12:00:00.123Z plant-7 ua-fleet 4711 login - {"event": "login"}'
    assert frame_message(message) == b"%d " % len(message) + message


def test_a_refusal_is_a_warning_and_the_header_is_printable() -> None:
    odd = Origin("pl ant\n\x1b\u00e4" + "x" * 300, 1)
    message = encode_message(b"{}", time="", event="e\n" + "v" * 50, refused=True, origin=odd)
    pri, stamp, host, name, process, kind, data, line = message.split(b" ")
    assert (pri, stamp, name, process, data, line) == (b"<108>1", b"-", b"ua-fleet", b"1", b"-", b"{}")
    assert (len(host), host[:6]) == (255, b"plantx")
    assert (len(kind), kind[:2]) == (32, b"ev")
    assert encode_message(b"", time="", event="", refused=False, origin=Origin("", 1)).startswith(
        b"<110>1 - - ua-fleet"
    )


@pytest.mark.parametrize(
    ("url", "destination", "text"),
    [
        ("tls://logs.plant", Destination("tls", "logs.plant", 6514), "tls://logs.plant:6514"),
        ("tls://10.0.0.7:7000", Destination("tls", "10.0.0.7", 7000), "tls://10.0.0.7:7000"),
        ("tcp://[::1]", Destination("tcp", "::1", 514), "tcp://[::1]:514"),
        ("udp://logs:514", Destination("udp", "logs", 514), "udp://logs:514"),
        ("unix:/dev/log", Destination("unix", path="/dev/log"), "unix:/dev/log"),
    ],
)
def test_destinations(url: str, destination: Destination, text: str) -> None:
    assert parse_destination(url) == destination
    assert str(destination) == text


@pytest.mark.parametrize(
    "url",
    [
        "",
        "logs",
        "http://logs",
        "tls://",
        "tls://logs:0",
        "tls://logs:70000",
        "tls://logs/x",
        "unix://dev/log",
        "unix:log",
    ],
)
def test_no_destinations(url: str) -> None:
    with pytest.raises(ValueError, match=r"write|[Pp]ort"):
        parse_destination(url)
