"""A client of o6 (open62541) that reads history: arguments are URL, user, password, its certificate and key, the
server's certificate, NodeId, start and end in ISO 8601.

It reads raw values, averages and alarms of the time, each page by page, and prints one JSON object.
"""

from __future__ import annotations

import importlib
import json
import sys
from datetime import datetime
from typing import Any

o6: Any = importlib.import_module("o6")
types: Any = importlib.import_module("o6.ns").ns0.datatypes
url, user, password, certificate, key, server, node, start, end = sys.argv[1:]
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
begin, until = o6.DateTime(datetime.fromisoformat(start)), o6.DateTime(datetime.fromisoformat(end))


def plain(value: Any) -> Any:
    """A value as JSON has it."""
    value = getattr(value, "value", value)
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, int | float | str | bool | None) else str(value)


def pages(details: Any, node_id: str) -> list[Any]:
    """The HistoryData or HistoryEvents of all pages."""
    found: list[Any] = []
    wanted = types.HistoryReadValueId()
    wanted.nodeId = o6.NodeId(node_id)
    while len(found) < 50:
        request = types.HistoryReadRequest()
        request.historyReadDetails = details
        request.timestampsToReturn = types.TimestampsToReturn.SOURCE
        request.nodesToRead = [wanted]
        [result] = client.serviceHistoryRead(request).results
        data = result.historyData
        found.append(getattr(data, "body", None) or data)
        if not result.continuationPoint:
            return found
        wanted.continuationPoint = result.continuationPoint
    raise AssertionError("it never ends")


def processed(function: int) -> list[Any]:
    """An aggregate in intervals of 20 s."""
    details = types.ReadProcessedDetails()
    details.startTime, details.endTime, details.processingInterval = begin, until, 20000.0
    details.aggregateType = [o6.NodeId(f"i={function}")]
    details.aggregateConfiguration.useServerCapabilitiesDefaults = True
    return [plain(value.value) for page in pages(details, node) for value in page.dataValues]


def events() -> list[Any]:
    """The messages of all alarms, and whether they were active."""
    details = types.ReadEventDetails()
    details.startTime, details.endTime, details.numValuesPerNode = begin, until, 1
    details.filter = types.EventFilter.parse("SELECT /Message, /ActiveState/Id, /EventId WHERE OFTYPE i=2955")
    found: list[Any] = []
    for page in pages(details, "i=2253"):
        found += getattr(page, "events", None) or []
    return [[plain(field) for field in event.eventFields] for event in found]


client.connect()
raw = client.historyRead(node, datetime.fromisoformat(start), datetime.fromisoformat(end))
report = {
    "raw": [plain(value.value) for value in raw.dataValues],
    "average": processed(2342),
    "maximum": processed(2347),
    "events": events(),
}
client.disconnect()
sys.stdout.write(f"{json.dumps(report)}\n")
