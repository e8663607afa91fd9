"""What the publishers of o6 beside this file have in common: a server with a Double that counts, and a DataSet of it.

It is imported by a Python that has o6. o6 ends by itself after ten minutes.
"""

# This is not run by the project's Python, and not checked with it.
# pyright: basic
# mypy: ignore-errors

from __future__ import annotations

import time
from typing import Any

import o6  # pyright: ignore[reportMissingImports]
from o6.ns.ns0 import datatypes as d  # pyright: ignore[reportMissingImports]

ADD_CONNECTION = ("i=14443", "i=17366")
"""PublishSubscribe and its method (OPC 10000-14 9.1.3.4)."""
COUNTER = "ns=1;i=5000"


class CountingPublisher:
    """A server of o6, and its connections with a DataSetWriter each."""

    def __init__(self, port: int, profile: str) -> None:
        self._profile = profile
        self._server = o6.Server(port)
        self._server.addVariable("counter", self._server.objectsNode, 0.5, nodeId=COUNTER)
        self._server.start()
        field = d.FieldMetaData(name="counter", builtInType=11, dataType=o6.NodeId("i=11"), valueRank=-1)
        source = d.PublishedDataItemsDataType(
            publishedData=[d.PublishedVariableDataType(publishedVariable=o6.NodeId(COUNTER), attributeId=13)]
        )
        self._server.addPublishedDataSet(
            d.PublishedDataSetDataType(
                name="ds", dataSetMetaData=d.DataSetMetaDataType(name="ds", fields=[field]), dataSetSource=source
            )
        )

    def add(
        self, name: str, publisher_id: Any, url: str, group_id: int, writer_id: int, *, writer: Any, group: Any
    ) -> str:
        """Add a connection; the status that open62541 answers with.

        `writer` and `group` are what the DataSetWriter and its WriterGroup have besides what all of them have.
        """
        data_set_writer = d.DataSetWriterDataType(
            name="writer", enabled=True, dataSetWriterId=writer_id, dataSetName="ds", keyFrameCount=1, **writer
        )
        writer_group = d.WriterGroupDataType(
            name="group",
            enabled=True,
            writerGroupId=group_id,
            publishingInterval=200.0,
            keepAliveTime=1000.0,
            maxNetworkMessageSize=1400,
            securityMode=1,
            dataSetWriters=[data_set_writer],
            **group,
        )
        connection = d.PubSubConnectionDataType(
            name=name,
            enabled=True,
            publisherId=publisher_id,
            transportProfileUri=self._profile,
            address=d.NetworkAddressUrlDataType(networkInterface="", url=url),
            writerGroups=[writer_group],
        )
        return self._server.call(*ADD_CONNECTION, [connection])[0].name

    def publish(self) -> None:
        """Count, five times a second, for ever."""
        self._server._setAllPubSubComponentsEnabled(True)
        print("publishing", flush=True)
        number = 0.0
        while True:
            number += 1.0
            self._server.write(COUNTER, number)
            time.sleep(0.2)
