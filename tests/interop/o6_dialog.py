"""A client of o6 (open62541) that answers a dialog: arguments are URL, user, password, its certificate and key, the
server's certificate, ConditionId, option.

It reads the dialog, gives a response that there is not, then the option, then another one, and prints one JSON object.
"""

from __future__ import annotations

import importlib
import json
import sys
from typing import Any

o6: Any = importlib.import_module("o6")
url, user, password, certificate, key, server, dialog, option = sys.argv[1:]
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


def read(member: str) -> Any:
    """The value of a member of the dialog."""
    found = client.read(f"{dialog}.{member}")
    return getattr(found, "value", found)


def respond(response: int) -> str:
    """The name of the StatusCode of Respond."""
    try:
        status, *_ = client.call(dialog, "i=9069", [o6.Int32(response)])
    except o6.StatusCodeError as error:
        return str(error)
    return str(status)


client.connect()
options = [each.text for each in read("ResponseOptionSet")]
report = {
    "active": bool(read("DialogState.Id")),
    "prompt": read("Prompt").text,
    "options": options,
    "wrong": respond(len(options)),
    "answered": respond(options.index(option)),
    "late": respond(0),
}
client.disconnect()
sys.stdout.write(f"{json.dumps(report)}\n")
