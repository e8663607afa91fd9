// A foreign OPC UA client drives a robot by hand: acquires it, echoes the counter that it watches, and releases it.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const { AttributeIds, DataType, TimestampsToReturn, VariantArrayType } = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const ROBOT = "ns=2;s=Robots.carrier";
const uint32 = (value) => ({ dataType: DataType.UInt32, value });

async function children(session, nodeId) {
  const result = await session.browse(nodeId);
  return Object.fromEntries(
    result.references.filter((ref) => ref.isForward).map((ref) => [ref.browseName.name, ref.nodeId.toString()]),
  );
}

foreign.report(async (session, report) => {
  const object = (await children(session, ROBOT)).Teleoperation;
  const members = await children(session, object);
  report.members = Object.keys(members);
  const value = async (name) => (await session.read({ nodeId: members[name], attributeId: AttributeIds.Value })).value.value;
  const call = async (name, ...inputArguments) => {
    const result = await session.call({ objectId: object, methodId: members[name], inputArguments });
    return { status: result.statusCode.name, output: (result.outputArguments || []).map((one) => one.value) };
  };
  report.executable = {};
  for (const name of ["Acquire", "Renew", "Release", "Drive"]) {
    const told = await session.read({ nodeId: members[name], attributeId: AttributeIds.UserExecutable });
    report.executable[name] = told.value.value;
  }
  const definition = await session.getArgumentDefinition(members.Drive);
  report.input = definition.inputArguments.map((one) => one.name);
  report.axes = await value("Axes");
  report.acquired = await call("Acquire", { dataType: DataType.Boolean, value: false });
  if (report.acquired.status !== "Good") return;

  let echo = report.acquired.output[1];
  report.counters = 0;
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50,
    requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 10,
    publishingEnabled: true,
  });
  const item = await subscription.monitor(
    { nodeId: members.Counter, attributeId: AttributeIds.Value },
    { samplingInterval: 50, queueSize: 1, discardOldest: true },
    TimestampsToReturn.Both,
  );
  item.on("changed", (data) => {
    echo = data.value.value;
    report.counters += 1;
  });
  const lease = uint32(report.acquired.output[0]);
  const statuses = {};
  const until = Date.now() + 2500;
  let number = 0;
  while (Date.now() < until) {
    number += 1;
    const values = { dataType: DataType.Double, arrayType: VariantArrayType.Array, value: [0.4, -0.2] };
    const { status } = await call("Drive", lease, uint32(number), uint32(echo), values);
    statuses[status] = (statuses[status] || 0) + 1;
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  report.driven = statuses;
  report.output = Array.from(await value("Output"));
  report.taken = await value("LastNumber");
  report.renewed = (await call("Renew", lease)).status;
  report.released = (await call("Release", lease)).status;
  report.after = (await call("Drive", lease, uint32(number + 1), uint32(echo), {
    dataType: DataType.Double,
    arrayType: VariantArrayType.Array,
    value: [0.4, 0],
  })).status;
  await subscription.terminate();
});
