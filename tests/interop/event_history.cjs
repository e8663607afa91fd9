// A foreign OPC UA client that reads the events which the server has kept.
// Arguments: endpoint URL, user, password, folder for its certificates, start and end (ISO 8601).
// Prints one JSON object.
"use strict";

const {
  AttributeIds,
  HistoryReadRequest,
  ReadEventDetails,
  TimestampsToReturn,
  constructEventFilter,
  ofType,
  resolveNodeId,
} = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const [start, end] = process.argv.slice(6);
const FIELDS = ["EventType", "SourceName", "Message", "Severity", "ActiveState.Id", "AckedState.Id", "EventId", "Time"];
const plain = (value) => {
  if (value === null || value === undefined) return null;
  if (value.text !== undefined) return value.text;
  if (Buffer.isBuffer(value)) return value.toString("hex");
  if (value instanceof Date) return value.toISOString();
  return typeof value === "object" ? String(value) : value;
};

// All pages: the events, each as an object, and how many pages there were.
async function read(session, filter, from, to, numValuesPerNode) {
  const historyReadDetails = new ReadEventDetails({
    startTime: new Date(from),
    endTime: new Date(to),
    numValuesPerNode,
    filter,
  });
  const found = { status: "", pages: 0, events: [] };
  let continuationPoint = null;
  do {
    const request = new HistoryReadRequest({
      historyReadDetails,
      nodesToRead: [{ nodeId: resolveNodeId("i=2253"), continuationPoint }],
      releaseContinuationPoints: false,
      timestampsToReturn: TimestampsToReturn.Both,
    });
    const response = await session.historyRead(request);
    const result = response.results[0];
    found.status = result.statusCode.name;
    found.pages += 1;
    for (const event of (result.historyData && result.historyData.events) || []) {
      const fields = event.eventFields.map((field) => plain(field.value));
      found.events.push(Object.fromEntries(FIELDS.map((name, index) => [name, fields[index]])));
    }
    continuationPoint = result.continuationPoint && result.continuationPoint.length ? result.continuationPoint : null;
  } while (continuationPoint && found.pages < 50);
  return found;
}

foreign.report(async (session, report) => {
  const notifier = await session.read({ nodeId: "i=2253", attributeId: AttributeIds.EventNotifier });
  report.notifier = notifier.value.value;
  report.all = await read(session, constructEventFilter(FIELDS), start, end, 2);
  const alarms = constructEventFilter(FIELDS, ofType("ExclusiveLevelAlarmType"));
  report.alarms = await read(session, alarms, start, end, 0);
  report.backward = await read(session, alarms, end, start, 0);
  const audit = constructEventFilter(FIELDS, ofType("AuditEventType"));
  report.audit = await read(session, audit, start, end, 0);
});
