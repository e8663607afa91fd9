"""Whom the broker of the testbed lets in, and what each of its users may write."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from tests.testbed.engine import CommandFailed, Container

__all__ = ["broker_problems"]

_AUTHORITY: Final = "/var/lib/ua-fleet/broker/broker-ca.pem"
_TLS: Final = ("--cafile", _AUTHORITY)
_WAIT_S: Final = "3"
_NOT_ALLOWED: Final = "Not authorized"


def broker_problems(containers: Mapping[str, Container]) -> list[str]:
    """What is not refused that has to be, and the other way round."""
    broker = containers["broker"]
    word = containers["yard-side"].execute("cat", "/var/lib/ua-fleet/yard_side/broker-password").strip()
    known = (*_TLS, "-u", "yard_side", "-P", word)
    found = [
        f"the broker lets in {who}"
        for who, options in {
            "whom it does not know": _TLS,
            "a wrong password": (*_TLS, "-u", "yard_side", "-P", f"{word}x"),
            "a user without TLS": ("-u", "yard_side", "-P", word),
        }.items()
        if _publish(broker, "302/test", *options) == ""
    ]
    if said := _publish(broker, "302/test", *known):
        found.append(f"the broker does not let yard_side write its own topic: {said}")
    found += [
        f"yard_side writes {topic}"
        for topic in ("0/ua_0_2_1000", "301/ua_301_2_1520", "opcua/uadp/action-request/301/actions-2")
        if _NOT_ALLOWED not in _publish(broker, topic, *known)
    ]
    return found


def _publish(broker: Container, topic: str, *options: str) -> str:
    """What `mosquitto_pub` complains about; nothing where the broker has acknowledged the message."""
    words = ("mosquitto_pub", "-h", "broker", "-p", "8883", "-V", "5", "-q", "1", "-m", "x", "-t", topic, *options)
    try:
        said = broker.execute("sh", "-c", f'timeout {_WAIT_S} "$@" 2>&1', "sh", *words)
    except CommandFailed as error:
        return str(error).strip() or "it failed"
    return said.strip()
