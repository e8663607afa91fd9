// A foreign OPC UA client runs a scenario: validates it, runs it, sees its events, ranks and confirms a replacement.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const { DataType, VariantArrayType } = require("node-opcua-client");
const { call, readValue, report, text, texts, watchEvents } = require("./foreign.cjs");

report(async (session, made) => {
  const watching = await watchEvents(session, made.events, 20000);
  const { seen } = watching;
  made.listed = (await call(session, "Scenarios", "List")).output[0];
  const wrong = "version: 1\nname: w\nsteps:\n  - {task: a, skill: jump, robot: left}\n";
  made.problems = (await call(session, "Scenarios", "Validate", text(wrong))).output;
  made.problems[2] = Array.from(made.problems[2]);
  const [runId] = (await call(session, "Scenarios", "Run", text("two"), texts([]), texts([]))).output;
  made.runId = runId;
  await seen((event) => event.fact === "TaskOver" && event.task === "first");
  await call(session, "Faults", "RaiseFault", text("left"), text("gripper stuck"));
  const open = await seen((event) => event.decisionState === "open");
  const none = { dataType: DataType.Double, arrayType: VariantArrayType.Array, value: [] };
  made.preview = (await call(session, "Resilience", "Preview", text(open.decision), texts([]), none)).output[0];
  made.confirmed = (await call(session, "Resilience", "Confirm", text(open.decision), text("right"))).output;
  made.refused = (await call(session, "Resilience", "Confirm", text(open.decision), text("middle"))).message;
  await seen((event) => event.run === runId && event.state === "done");
  made.robots = await readValue(session, `ns=2;s=Fleet.Scenarios.Runs.${runId}.Robots`);
  const [stored, version] = (await call(session, "Scenarios", "Text", text("two"))).output;
  made.stored = [stored.includes("name: two"), version.length];
  const robot = "ns=2;s=Robots.left";
  const hold = (methodId, inputArguments) => session.call({ objectId: robot, methodId, inputArguments });
  made.held = (await hold("ns=3;i=72051", [text("new tyre")])).outputArguments.map((one) => one.value);
  await seen((event) => event.message.startsWith("left is held by"));
  made.heldBy = await readValue(session, `${robot}.HeldBy`);
  made.heldAgain = (await hold("ns=3;i=72052", [])).outputArguments[1].value;
  await watching.end();
});
