// A foreign OPC UA client, logged in as somebody, calls Methods without arguments and writes a value.
// Arguments: endpoint URL, user, password, folder for its certificates, Methods as [[object, method]], a Variable.
// Prints one JSON object: for each Method UserExecutable and the StatusCode, and the StatusCode of the Write.
"use strict";

const { AttributeIds, DataType } = require("node-opcua-client");
const { report } = require("./foreign.cjs");

const [methods, variable] = process.argv.slice(6);

report(async (session, made) => {
  made.methods = {};
  for (const [objectId, methodId] of JSON.parse(methods)) {
    const may = await session.read({ nodeId: methodId, attributeId: AttributeIds.UserExecutable });
    const result = await session.call({ objectId, methodId, inputArguments: [] });
    made.methods[methodId] = [may.value.value, result.statusCode.name];
  }
  const value = { value: { dataType: DataType.Double, value: 12 } };
  const written = await session.write({ nodeId: variable, attributeId: AttributeIds.Value, value });
  made.written = written.name;
  const read = await session.read({ nodeId: variable, attributeId: AttributeIds.Value });
  made.read = [read.statusCode.name, read.value.value];
});
