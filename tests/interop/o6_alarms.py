"""A client of o6 (open62541) that looks after an alarm: arguments are URL, user, password, its certificate and key, the
server's certificate, ConditionId.

It reads the alarm, acknowledges its last event twice, shelves and unshelves it, and prints one JSON object.
"""

from __future__ import annotations

import importlib
import json
import sys
from typing import Any

o6: Any = importlib.import_module("o6")
url, user, password, certificate, key, server, alarm = sys.argv[1:]
client = o6.Client(
    url,
    certificate=certificate,
    privateKey=key,
    trustList=[server],
    securityMode=3,
    securityPolicy="http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256",
    applicationUri="urn:test:client",
    username=user,
    password=password,
)


def call(owner: str, method: str, *arguments: object) -> str:
    """The name of the StatusCode of a call."""
    try:
        status, *_ = client.call(owner, method, list(arguments))
    except o6.StatusCodeError as error:
        return str(error)
    return str(status)


def read(member: str) -> object:
    """The value of a member of the alarm."""
    found = client.read(f"{alarm}.{member}")
    return getattr(found, "value", found)


client.connect()
event_id, shelving = read("EventId"), f"{alarm}.ShelvingState"
report = {
    "active": bool(read("ActiveState.Id")),
    "acknowledged": call(alarm, "i=9111", event_id, o6.LocalizedText("", "seen")),
    "again": call(alarm, "i=9111", event_id, o6.LocalizedText("", "seen")),
    "shelved": call(shelving, "i=2949", o6.Double(60000)),
    "state": str(read("ShelvingState.CurrentState")),
    "unshelved": call(shelving, "i=2947"),
}
client.disconnect()
sys.stdout.write(f"{json.dumps(report)}\n")
