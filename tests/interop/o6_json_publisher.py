"""A publisher of o6 (open62541) of JSON over MQTT, without metadata: `o6_json_publisher.py BROKER_PORT UA_PORT JSON`.

It is run by a Python that has o6.

JSON is a list of [PublisherId, QueueName, DataSetWriterId, DataSetFieldContentMask]: a connection for each, with one
WriterGroup, and in it one DataSetWriter of a Double that counts. o6 ends by itself after ten minutes.
"""

# This is not run by the project's Python, and not checked with it.
# pyright: basic
# mypy: ignore-errors

from __future__ import annotations

import json
import sys
import time

import o6  # pyright: ignore[reportMissingImports]
from o6.ns.ns0 import datatypes as d  # pyright: ignore[reportMissingImports]

ADD_CONNECTION = ("i=14443", "i=17366")
"""PublishSubscribe and its method (OPC 10000-14 9.1.3.4)."""
MQTT_JSON = "http://opcfoundation.org/UA-Profile/Transport/pubsub-mqtt-json"
ALL = 0x1F
"""All headers: open62541 writes the same whatever the masks say."""
AT_LEAST_ONCE = 2

broker_port, port, wanted = sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3])
server = o6.Server(port)
server.addVariable("counter", server.objectsNode, 0.5, nodeId="ns=1;i=5000")
server.start()
field = d.FieldMetaData(name="counter", builtInType=11, dataType=o6.NodeId("i=11"), valueRank=-1)
source = d.PublishedDataItemsDataType(
    publishedData=[d.PublishedVariableDataType(publishedVariable=o6.NodeId("ns=1;i=5000"), attributeId=13)]
)
server.addPublishedDataSet(
    d.PublishedDataSetDataType(
        name="ds", dataSetMetaData=d.DataSetMetaDataType(name="ds", fields=[field]), dataSetSource=source
    )
)
for publisher_id, queue, writer_id, field_mask in wanted:
    writer = d.DataSetWriterDataType(
        name="writer",
        enabled=True,
        dataSetWriterId=writer_id,
        dataSetName="ds",
        keyFrameCount=1,
        dataSetFieldContentMask=field_mask,
        messageSettings=d.JsonDataSetWriterMessageDataType(dataSetMessageContentMask=ALL),
    )
    group = d.WriterGroupDataType(
        name="group",
        enabled=True,
        writerGroupId=2,
        publishingInterval=200.0,
        keepAliveTime=1000.0,
        maxNetworkMessageSize=1400,
        securityMode=1,
        dataSetWriters=[writer],
        transportSettings=d.BrokerWriterGroupTransportDataType(
            queueName=queue, requestedDeliveryGuarantee=AT_LEAST_ONCE
        ),
        messageSettings=d.JsonWriterGroupMessageDataType(networkMessageContentMask=ALL),
    )
    connection = d.PubSubConnectionDataType(
        name=queue,
        enabled=True,
        publisherId=o6.UInt16(publisher_id),
        transportProfileUri=MQTT_JSON,
        address=d.NetworkAddressUrlDataType(networkInterface="", url=f"opc.mqtt://127.0.0.1:{broker_port}"),
        writerGroups=[group],
    )
    print("connection", publisher_id, server.call(*ADD_CONNECTION, [connection])[0].name, flush=True)
server._setAllPubSubComponentsEnabled(True)
print("publishing", flush=True)
number = 0.0
while True:
    number += 1.0
    server.write("ns=1;i=5000", number)
    time.sleep(0.2)
