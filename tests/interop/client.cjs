// A foreign OPC UA client: connects encrypted with user and password, browses, reads, subscribes and writes.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const {
  AttributeIds,
  DataType,
  TimestampsToReturn,
} = require("node-opcua-client");
const foreign = require("./foreign.cjs");


async function browseNames(session, nodeId) {
  const result = await session.browse(nodeId);
  return result.references.filter((ref) => ref.isForward).map((ref) => ref.browseName.toString());
}

function shown(dataValue) {
  return {
    value: dataValue.value.value,
    dataType: DataType[dataValue.value.dataType],
    status: dataValue.statusCode.name,
    sourceTimestamp: dataValue.sourceTimestamp ? dataValue.sourceTimestamp.toISOString() : null,
    serverTimestamp: dataValue.serverTimestamp ? dataValue.serverTimestamp.toISOString() : null,
  };
}

foreign.report(async (session, report) => {
  report.namespaces = await session.readNamespaceArray();
  report.fleet = await browseNames(session, "ns=2;s=Fleet");
  report.robot = await browseNames(session, "ns=2;s=Robots.rover");
  report.data = await browseNames(session, "ns=2;s=Robots.rover.Data");
  report.speed = shown(await session.read({ nodeId: "ns=2;i=1001", attributeId: AttributeIds.Value }));
  const unit = await session.read({ nodeId: "ns=2;s=1001.EngineeringUnits", attributeId: AttributeIds.Value });
  report.unit = unit.value.value.displayName.text;
  const range = await session.read({ nodeId: "ns=2;s=1001.EURange", attributeId: AttributeIds.Value });
  report.range = [range.value.value.low, range.value.value.high];

  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50,
    requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 10,
    publishingEnabled: true,
  });
  const item = await subscription.monitor(
    { nodeId: "ns=2;i=1001", attributeId: AttributeIds.Value },
    { samplingInterval: 50, queueSize: 10, discardOldest: true },
    TimestampsToReturn.Both,
  );
  report.notified = [];
  const seen = new Promise((resolve) => {
    item.on("changed", (dataValue) => {
      report.notified.push(shown(dataValue));
      if (report.notified.length >= 3) resolve();
    });
  });

  const write = async (nodeId, dataType, value) => {
    const status = await session.write({
      nodeId,
      attributeId: AttributeIds.Value,
      value: { value: { dataType, value } },
    });
    return status.name;
  };
  report.writes = {
    legal: await write("ns=2;i=1002", DataType.Double, 0.5),
    outOfRange: await write("ns=2;i=1002", DataType.Double, 7),
    notANumber: await write("ns=2;i=1002", DataType.Double, NaN),
    wrongType: await write("ns=2;i=1002", DataType.Int32, 1),
    robotsOwn: await write("ns=2;i=1001", DataType.Double, 1),
  };
  report.written = shown(await session.read({ nodeId: "ns=2;i=1002", attributeId: AttributeIds.Value }));

  await Promise.race([
    seen,
    new Promise((_, reject) => setTimeout(() => reject(new Error("no notifications in 15 s")), 15000).unref()),
  ]);
  await subscription.terminate();
});
