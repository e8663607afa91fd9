"""A publisher of o6 (open62541), which announces no metadata: `o6_publisher.py URL UA_PORT JSON`.

It is run by a Python that has o6.

JSON is a list of [type of PublisherId, PublisherId, WriterGroupId, DataSetWriterId]: a connection for each, with one
WriterGroup, and in it one DataSetWriter of a Double that counts.
"""

# This is not run by the project's Python, and not checked with it.
# pyright: basic
# mypy: ignore-errors

from __future__ import annotations

import json
import sys

import o6  # pyright: ignore[reportMissingImports]
from o6.ns.ns0 import datatypes as d  # pyright: ignore[reportMissingImports]
from o6_counting import CountingPublisher  # pyright: ignore[reportMissingImports]

UDP_UADP = "http://opcfoundation.org/UA-Profile/Transport/pubsub-udp-uadp"
PUBLISHER_ID, GROUP_HEADER, WRITER_GROUP_ID, PAYLOAD_HEADER = 0x01, 0x02, 0x04, 0x40
TIMESTAMP, STATUS, MAJOR_VERSION, SEQUENCE_NUMBER = 0x01, 0x04, 0x08, 0x20

url, port, wanted = sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3])
publisher = CountingPublisher(port, UDP_UADP)
for kind, publisher_id, group_id, writer_id in wanted:
    status = publisher.add(
        f"{kind} {publisher_id}",
        publisher_id if kind == "String" else getattr(o6, kind)(publisher_id),
        url,
        group_id,
        writer_id,
        writer={
            "messageSettings": d.UadpDataSetWriterMessageDataType(
                dataSetMessageContentMask=TIMESTAMP | STATUS | MAJOR_VERSION | SEQUENCE_NUMBER
            )
        },
        group={
            "messageSettings": d.UadpWriterGroupMessageDataType(
                networkMessageContentMask=PUBLISHER_ID | GROUP_HEADER | WRITER_GROUP_ID | PAYLOAD_HEADER
            )
        },
    )
    print("connection", kind, publisher_id, status, flush=True)
publisher.publish()
