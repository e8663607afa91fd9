// A foreign OPC UA client that reads what the server has kept of a value, as it was and calculated.
// Arguments: endpoint URL, user, password, folder for its certificates, NodeId, start and end (ISO 8601).
// Prints one JSON object.
"use strict";

const {
  AggregateFunction,
  AttributeIds,
  HistoryReadRequest,
  ReadAtTimeDetails,
  ReadProcessedDetails,
  ReadRawModifiedDetails,
  TimestampsToReturn,
  resolveNodeId,
} = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const [nodeId, start, end] = process.argv.slice(6);
const [startTime, endTime] = [new Date(start), new Date(end)];

// One page of a node: what it holds, and the continuation point, which is null at the end.
async function page(session, historyReadDetails, continuationPoint) {
  const request = new HistoryReadRequest({
    historyReadDetails,
    nodesToRead: [{ nodeId: resolveNodeId(nodeId), continuationPoint }],
    releaseContinuationPoints: false,
    timestampsToReturn: TimestampsToReturn.Both,
  });
  const response = await session.historyRead(request);
  const result = response.results[0];
  const values = result.historyData ? result.historyData.dataValues : [];
  return {
    status: result.statusCode.name,
    point: result.continuationPoint,
    values: values.map((data) => ({
      value: data.value ? data.value.value : null,
      status: data.statusCode.value,
      time: data.sourceTimestamp.toISOString(),
    })),
  };
}

async function whole(session, details) {
  const found = { status: "", pages: 0, values: [] };
  let point = null;
  do {
    const one = await page(session, details, point);
    found.status = one.status;
    found.pages += 1;
    found.values.push(...one.values);
    point = one.point && one.point.length ? one.point : null;
  } while (point && found.pages < 20);
  return found;
}

foreign.report(async (session, report) => {
  const raw = { isReadModified: false, startTime, endTime, numValuesPerNode: 3, returnBounds: true };
  report.raw = await whole(session, new ReadRawModifiedDetails(raw));
  const times = [new Date(startTime.getTime() + 15000), startTime];
  report.atTimes = await whole(session, new ReadAtTimeDetails({ reqTimes: times, useSimpleBounds: false }));
  report.processed = {};
  for (const name of ["Average", "TimeAverage", "Minimum", "Maximum", "Count", "PercentGood"]) {
    const details = new ReadProcessedDetails({
      aggregateType: [resolveNodeId(AggregateFunction[name])],
      startTime,
      endTime,
      processingInterval: 20000,
      aggregateConfiguration: { useServerCapabilitiesDefaults: true },
    });
    report.processed[name] = await whole(session, details);
  }
  const access = await session.read({ nodeId, attributeId: AttributeIds.AccessLevel });
  const historizing = await session.read({ nodeId, attributeId: AttributeIds.Historizing });
  report.node = { accessLevel: access.value.value, historizing: historizing.value.value };
  // The client's own way to read history, by which viewers do it.
  const own = await session.readHistoryValue(nodeId, startTime, endTime);
  report.own = own.historyData.dataValues.map((data) => data.value.value);
});
