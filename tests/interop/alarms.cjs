// A foreign OPC UA client that looks after alarms: it reads one, acknowledges, comments, shelves; or answers a dialog.
// Arguments: endpoint URL, user, password, folder for its certificates, ConditionId of an alarm, or `dialog` and an option.
// Prints one JSON object.
"use strict";

const {
  AttributeIds,
  BrowseDirection,
  DataType,
  SimpleAttributeOperand,
  TimestampsToReturn,
  constructEventFilter,
  ofType,
  resolveNodeId,
} = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const [wanted, option] = process.argv.slice(6);
const FIELDS = [
  "EventId",
  "EventType",
  "Message",
  "Retain",
  "ActiveState.Id",
  "AckedState.Id",
  "Comment",
  "SuppressedOrShelved",
  "ShelvingState.CurrentState",
  "DialogState.Id",
  "Prompt",
  "ResponseOptionSet",
  "LastResponse",
];

const plain = (value) => (value && value.text !== undefined ? value.text : value);

// Subscribes to conditions; `next` waits for the first event that fits, from those that have come already on.
async function watch(session) {
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50,
    requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 10,
    publishingEnabled: true,
  });
  const filter = constructEventFilter(FIELDS, ofType("ConditionType"));
  filter.selectClauses.push(
    new SimpleAttributeOperand({ typeDefinitionId: resolveNodeId("i=2782"), attributeId: AttributeIds.NodeId }),
  );
  const item = await subscription.monitor(
    { nodeId: "i=2253", attributeId: AttributeIds.EventNotifier },
    { samplingInterval: 0, queueSize: 1000, discardOldest: true, filter },
    TimestampsToReturn.Both,
  );
  const events = [];
  item.on("changed", (values) => {
    const event = { id: String(values[FIELDS.length].value) };
    FIELDS.forEach((name, index) => (event[name] = plain(values[index].value)));
    events.push(event);
  });
  const next = async (fits) => {
    for (let tries = 0; tries < 400; tries += 1) {
      const found = events.find(fits);
      if (found) return found;
      await new Promise((done) => setTimeout(done, 50));
    }
    throw new Error(`no such event: ${fits} among ${events.length}`);
  };
  return { subscription, events, next };
}

const shown = (event) => ({ ...event, EventId: event.EventId.toString("hex"), EventType: String(event.EventType) });

async function call(session, objectId, methodId, ...inputArguments) {
  return (await session.call({ objectId, methodId, inputArguments })).statusCode.name;
}

async function alarm(session, watched, report) {
  const { subscription, next } = watched;
  const refreshed = await call(session, "i=2782", "i=3875", { dataType: DataType.UInt32, value: subscription.subscriptionId });
  const active = await next((event) => event.id === wanted && event["ActiveState.Id"]);
  report.refreshed = refreshed;
  report.active = shown(active);
  const found = await session.browse({
    nodeId: wanted,
    browseDirection: BrowseDirection.Forward,
    resultMask: 63,
  });
  report.members = found.references.map((reference) => reference.browseName.name);
  report.acknowledged = (await session.acknowledgeCondition(wanted, active.EventId, "seen")).name;
  report.again = (await session.acknowledgeCondition(wanted, active.EventId, "seen")).name;
  report.comment = (await session.addCommentCondition(wanted, active.EventId, "a stone")).name;
  report.commented = shown(await next((event) => event.Comment === "a stone"));
  const shelving = `${wanted}.ShelvingState`;
  report.shelved = await call(session, shelving, "i=2949", { dataType: DataType.Double, value: 60000 });
  report.shelvedEvent = shown(await next((event) => event.SuppressedOrShelved));
  report.shelvedAgain = await call(session, shelving, "i=2949", { dataType: DataType.Double, value: 60000 });
  report.unshelved = await call(session, shelving, "i=2947");
}

async function dialog(session, watched, report) {
  const { subscription, next } = watched;
  await call(session, "i=2782", "i=3875", { dataType: DataType.UInt32, value: subscription.subscriptionId });
  const open = await next((event) => event["DialogState.Id"]);
  const options = open.ResponseOptionSet.map(plain);
  report.open = { ...shown(open), ResponseOptionSet: options };
  const respond = (value) => call(session, open.id, "i=9069", { dataType: DataType.Int32, value });
  report.wrong = await respond(options.length);
  report.answered = await respond(options.indexOf(option));
  const closed = await next((event) => event.id === open.id && event["DialogState.Id"] === false);
  report.closed = { ...shown(closed), ResponseOptionSet: closed.ResponseOptionSet.map(plain) };
  report.late = await respond(0);
}

foreign.report(async (session, report) => {
  const watched = await watch(session);
  await (wanted === "dialog" ? dialog : alarm)(session, watched, report);
  await watched.subscription.terminate();
});
