// A foreign OPC UA client at a skill: browses it, reads Start's arguments, calls Start and sees the events of it.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const {
  AttributeIds,
  constructEventFilter,
  DataType,
  TimestampsToReturn,
} = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const SKILL = "ns=2;i=1900";
const START = "ns=2;s=1900.Start";
const FIELDS = ["EventType", "SourceNode", "SourceName", "Message", "Severity", "FromState", "ToState", "Transition"];
const OWN = ["3:Robot", "3:Skill", "3:ExecutionId", "3:IsOver", "3:Status", "3:ResultNames", "3:Results"];

async function browseNames(session, nodeId) {
  const result = await session.browse(nodeId);
  return result.references.filter((ref) => ref.isForward).map((ref) => ref.browseName.toString());
}

async function callStart(session, inputArguments) {
  const result = await session.call({ objectId: SKILL, methodId: START, inputArguments });
  return {
    status: result.statusCode.name,
    arguments: (result.inputArgumentResults || []).map((status) => status.name),
    output: (result.outputArguments || []).map((variant) => variant.value),
  };
}

foreign.report(async (session, report) => {
  report.skills = await browseNames(session, "ns=2;s=Robots.machine.Skills");
  report.members = await browseNames(session, SKILL);
  const definition = await session.getArgumentDefinition(START);
  report.input = definition.inputArguments.map((one) => ({
    name: one.name,
    dataType: one.dataType.toString(),
    description: one.description.text,
  }));
  report.output = definition.outputArguments.map((one) => one.name);

  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50,
    requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 10,
    publishingEnabled: true,
  });
  const item = await subscription.monitor(
    { nodeId: "i=2253", attributeId: AttributeIds.EventNotifier },
    { samplingInterval: 0, queueSize: 100, discardOldest: true, filter: constructEventFilter([...FIELDS, ...OWN]) },
    TimestampsToReturn.Both,
  );
  const over = new Promise((resolve) => {
    item.on("changed", (fields) => {
      const event = {};
      [...FIELDS, ...OWN].forEach((name, index) => {
        const value = fields[index].value;
        event[name] = value && value.text !== undefined ? value.text : value;
      });
      if (!event["3:ExecutionId"]) return;
      report.events.push({
        source: event.SourceNode.toString(),
        name: event.SourceName,
        from: event.FromState,
        to: event.ToState,
        transition: event.Transition,
        robot: event["3:Robot"],
        execution: event["3:ExecutionId"],
        isOver: event["3:IsOver"],
        status: event["3:Status"].name,
        names: event["3:ResultNames"],
        results: Array.from(event["3:Results"] || []).map((variant) => variant.value),
      });
      if (event["3:IsOver"]) resolve();
    });
  });

  const work = { dataType: DataType.String, value: "polish" };
  report.outOfRange = await callStart(session, [work, { dataType: DataType.Double, value: 11 }]);
  report.wrongType = await callStart(session, [work, { dataType: DataType.String, value: "1" }]);
  report.missing = await callStart(session, [work]);
  for (let attempt = 0; attempt < 100; attempt++) {
    report.started = await callStart(session, [work, { dataType: DataType.Double, value: 0.3 }]);
    if (report.started.status !== "BadNoCommunication") break;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  await Promise.race([
    over,
    new Promise((_, reject) => setTimeout(() => reject(new Error("no end in 15 s")), 15000).unref()),
  ]);
  const done = await session.read({ nodeId: "ns=2;s=1900.Result.done", attributeId: AttributeIds.Value });
  report.done = done.value.value;
  const state = await session.read({ nodeId: "ns=2;s=1900.CurrentState", attributeId: AttributeIds.Value });
  report.state = state.value.value.text;

  const told = async (count) => {
    for (let attempt = 0; report.events.length < count; attempt++) {
      if (attempt === 150) throw new Error(`${report.events.length} events and not ${count} in 15 s`);
      await new Promise((resolve) => setTimeout(resolve, 100));
    }
  };
  const ask = async (method) => {
    const answer = await session.call({ objectId: SKILL, methodId: `ns=3;i=${method}`, inputArguments: [] });
    report.asked.push(answer.statusCode.name);
  };
  report.asked = [];
  const endless = { dataType: DataType.String, value: "never ends" };
  await callStart(session, [endless, { dataType: DataType.Double, value: 0 }]);
  for (const [method, events] of [[71002, 4], [71003, 5], [71002, 6], [71004, 7]]) {
    await told(events - 1);
    await ask(method); // Suspend, Resume, Suspend, Halt
    await told(events);
  }
  await subscription.terminate();
});
