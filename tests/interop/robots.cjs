// A foreign OPC UA client registers a robot, has it do something, unregisters it, and does a skill itself.
// Arguments: endpoint URL, user, password, folder for its certificates, definition of the robot, definition of a skill.
// Prints one JSON object.
"use strict";

const {
  AttributeIds,
  constructEventFilter,
  DataType,
  TimestampsToReturn,
  VariantArrayType,
} = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const [robot, skill] = process.argv.slice(6);
const FIELDS = ["EventType", "Changes", "3:State", "3:ExecutionId", "3:ArgumentNames", "3:Arguments"];

const text = (value) => ({ dataType: DataType.String, value });
const texts = (value) => ({ dataType: DataType.String, arrayType: VariantArrayType.Array, value });
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

async function call(session, owner, name, inputArguments) {
  const result = await session.call({ objectId: `ns=2;s=${owner}`, methodId: `ns=2;s=${owner}.${name}`, inputArguments });
  const values = (result.outputArguments || []).map((variant) => variant.value);
  const [status, message] = values.slice(-2);
  return { code: result.statusCode.name, status: Number(status && status[1]), message, outputs: values.slice(0, -2) };
}

async function start(session, id, inputArguments) {
  for (let attempt = 0; attempt < 100; attempt++) {
    const result = await session.call({ objectId: `ns=2;i=${id}`, methodId: `ns=2;s=${id}.Start`, inputArguments });
    if (result.statusCode.name !== "BadNoCommunication") return result.statusCode.name;
    await pause(100);
  }
  return "BadNoCommunication";
}

async function until(read, expected) {
  for (let attempt = 0; attempt < 150; attempt++) {
    const value = await read();
    if (expected(value)) return value;
    await pause(100);
  }
  throw new Error("it did not come in 15 s");
}

foreign.report(async (session, report) => {
  Object.assign(report, { changes: [], asked: [] });
  const value = async (nodeId) => (await session.read({ nodeId, attributeId: AttributeIds.Value })).value.value;
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50,
    requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 10,
    publishingEnabled: true,
  });
  const item = await subscription.monitor(
    { nodeId: "i=2253", attributeId: AttributeIds.EventNotifier },
    { samplingInterval: 0, queueSize: 100, discardOldest: true, filter: constructEventFilter(FIELDS) },
    TimestampsToReturn.Both,
  );
  item.on("changed", (fields) => {
    const [, changes, state, execution, names, values] = fields.map((field) => field.value);
    for (const change of changes || []) report.changes.push([change.affected.toString(), change.verb]);
    if (state === "asked") {
      report.asked.push({ execution, names, values: Array.from(values).map((variant) => variant.value) });
    }
  });

  const wrong = await call(session, "Fleet", "RegisterRobot", [
    text("machine"), text("cell"), texts([]), text(""), text("skills:\n  work: {needs: [fly]}\n"),
  ]);
  report.wrong = { status: wrong.status, lines: Array.from(wrong.outputs[2]) };
  const done = await call(session, "Fleet", "RegisterRobot", [
    text("machine"), text("cell"), texts([]), text(""), text(robot),
  ]);
  report.registered = { status: done.status, message: done.message, node: done.outputs[0].toString() };
  report.started = await start(session, 1900, [text("polish"), { dataType: DataType.Double, value: 0.1 }]);
  report.done = await until(() => value("ns=2;s=1900.Result.done"), (one) => one !== null);
  await until(() => value("ns=2;s=Robots.machine.State"), (one) => one === 1);
  report.unregistered = (await call(session, "Fleet", "UnregisterRobot", [text("machine")])).status;
  const gone = await session.read({ nodeId: "ns=2;s=Robots.machine.State", attributeId: AttributeIds.Value });
  report.gone = gone.statusCode.name;

  const offered = await call(session, "Fleet.Offers", "OfferSkill", [text("mechanic"), text("repair"), text(skill)]);
  report.offered = { status: offered.status, message: offered.message };
  const id = offered.outputs[0].value;
  report.asking = await start(session, id, [text("the belt")]);
  await until(async () => report.asked.length, (count) => count === 1);
  const execution = text(report.asked[0].execution);
  report.accepted = (await call(session, "Fleet.Offers", "Accept", [execution])).status;
  report.completed = (
    await call(session, "Fleet.Offers", "Complete", [execution, texts(["fixed"]), texts(["true"]), text("as new")])
  ).status;
  report.fixed = await until(() => value(`ns=2;s=${id}.Result.fixed`), (one) => one !== null);
  await subscription.terminate();
});
