"""A publisher of o6 (open62541) of JSON over MQTT, without metadata: `o6_json_publisher.py BROKER_PORT UA_PORT JSON`.

It is run by a Python that has o6.

JSON is a list of [PublisherId, QueueName, DataSetWriterId, DataSetFieldContentMask]: a connection for each, with one
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

MQTT_JSON = "http://opcfoundation.org/UA-Profile/Transport/pubsub-mqtt-json"
ALL = 0x1F
"""All headers: open62541 writes the same whatever the masks say."""
AT_LEAST_ONCE = 2
GROUP_ID = 2

broker_port, port, wanted = sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3])
publisher = CountingPublisher(port, MQTT_JSON)
for publisher_id, queue, writer_id, field_mask in wanted:
    status = publisher.add(
        queue,
        o6.UInt16(publisher_id),
        f"opc.mqtt://127.0.0.1:{broker_port}",
        GROUP_ID,
        writer_id,
        writer={
            "dataSetFieldContentMask": field_mask,
            "messageSettings": d.JsonDataSetWriterMessageDataType(dataSetMessageContentMask=ALL),
        },
        group={
            "transportSettings": d.BrokerWriterGroupTransportDataType(
                queueName=queue, requestedDeliveryGuarantee=AT_LEAST_ONCE
            ),
            "messageSettings": d.JsonWriterGroupMessageDataType(networkMessageContentMask=ALL),
        },
    )
    print("connection", publisher_id, status, flush=True)
publisher.publish()
