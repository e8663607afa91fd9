// A foreign OPC UA client at the testbed, as UaExpert is used there: browses robots, reads a value, starts a skill.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const { AttributeIds, DataType } = require("node-opcua-client");
const { readValue, report } = require("./foreign.cjs");

const TRANSPORT = "ns=2;i=1510";
const POSITION = "ns=2;i=1521";

report(async (session, made) => {
  const browsed = await session.browse("ns=2;s=Fleet.Robots");
  made.robots = [];
  for (const group of browsed.references.filter((ref) => ref.isForward)) {
    made.robots.push(group.browseName.toString());
    const below = await session.browse(group.nodeId);
    made.robots.push(...below.references.filter((ref) => ref.isForward).map((ref) => ref.browseName.toString()));
  }
  const temperature = await session.read({ nodeId: "ns=2;i=1620", attributeId: AttributeIds.Value });
  made.temperature = { status: temperature.statusCode.name, value: temperature.value.value };
  const before = await readValue(session, POSITION);
  const answer = await session.call({
    objectId: TRANSPORT,
    methodId: `ns=2;s=1510.Start`,
    inputArguments: [
      { dataType: DataType.Int32, value: 40 },
      { dataType: DataType.UInt16, value: 400 },
    ],
  });
  made.started = answer.statusCode.name;
  made.moved = false;
  for (let attempt = 0; attempt < 100 && !made.moved; attempt++) {
    await new Promise((resolve) => setTimeout(resolve, 100));
    made.moved = (await readValue(session, POSITION)) === before + 40;
  }
});
