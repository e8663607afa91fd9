"""A publisher of o6 (open62541), which announces no metadata: `o6_publisher.py URL UA_PORT JSON`.

It is run by a Python that has o6.

JSON is a list of [type of PublisherId, PublisherId, WriterGroupId, DataSetWriterId]: a connection for each, with one
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
UDP_UADP = "http://opcfoundation.org/UA-Profile/Transport/pubsub-udp-uadp"
PUBLISHER_ID, GROUP_HEADER, WRITER_GROUP_ID, PAYLOAD_HEADER = 0x01, 0x02, 0x04, 0x40
TIMESTAMP, STATUS, MAJOR_VERSION, SEQUENCE_NUMBER = 0x01, 0x04, 0x08, 0x20

url, port, wanted = sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3])
server = o6.Server(port)
counter = server.addVariable("counter", server.objectsNode, 0.5, nodeId="ns=1;i=5000")
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
for kind, publisher_id, group_id, writer_id in wanted:
    writer = d.DataSetWriterDataType(
        name="writer",
        enabled=True,
        dataSetWriterId=writer_id,
        dataSetName="ds",
        keyFrameCount=1,
        messageSettings=d.UadpDataSetWriterMessageDataType(
            dataSetMessageContentMask=TIMESTAMP | STATUS | MAJOR_VERSION | SEQUENCE_NUMBER
        ),
    )
    group = d.WriterGroupDataType(
        name="group",
        enabled=True,
        writerGroupId=group_id,
        publishingInterval=200.0,
        keepAliveTime=1000.0,
        maxNetworkMessageSize=1400,
        securityMode=1,
        dataSetWriters=[writer],
        messageSettings=d.UadpWriterGroupMessageDataType(
            networkMessageContentMask=PUBLISHER_ID | GROUP_HEADER | WRITER_GROUP_ID | PAYLOAD_HEADER
        ),
    )
    connection = d.PubSubConnectionDataType(
        name=f"{kind} {publisher_id}",
        enabled=True,
        publisherId=publisher_id if kind == "String" else getattr(o6, kind)(publisher_id),
        transportProfileUri=UDP_UADP,
        address=d.NetworkAddressUrlDataType(networkInterface="", url=url),
        writerGroups=[group],
    )
    print("connection", kind, publisher_id, server.call(*ADD_CONNECTION, [connection])[0].name, flush=True)
server._setAllPubSubComponentsEnabled(True)
print("publishing", flush=True)
number = 0.0
while True:
    number += 1.0
    server.write("ns=1;i=5000", number)
    time.sleep(0.2)
