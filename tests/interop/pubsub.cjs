// A foreign OPC UA client that browses PublishSubscribe by BrowseNames, reads what it finds, and disables and enables a
// DataSetWriter of a bridge. Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const { AttributeIds, BrowseDirection } = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const HIERARCHICAL = "i=33";

async function children(session, nodeId) {
  const found = await session.browse({
    nodeId,
    referenceTypeId: HIERARCHICAL,
    includeSubtypes: true,
    browseDirection: BrowseDirection.Forward,
    resultMask: 63,
  });
  return new Map(found.references.map((reference) => [reference.browseName.name, reference]));
}

foreign.report(async (session, report) => {
  async function at(...names) {
    let nodeId = "i=14443";
    for (const name of names) {
      // A bridge that says anew what it has has new nodes: for a moment it has none.
      let reference;
      for (let tries = 0; tries < 100 && !reference; tries += 1) {
        if (tries) await new Promise((resolve) => setTimeout(resolve, 100));
        reference = (await children(session, nodeId)).get(name);
      }
      if (!reference) throw new Error(`${names.join("/")}: no ${name}`);
      nodeId = reference.nodeId;
    }
    return nodeId;
  }
  async function read(...names) {
    const answer = await session.read({ nodeId: await at(...names), attributeId: AttributeIds.Value });
    if (answer.statusCode.name !== "Good") throw new Error(`${names.join("/")}: ${answer.statusCode.name}`);
    return answer.value.value;
  }
  async function call(name, ...names) {
    const objectId = await at(...names, "Status");
    const methodId = (await children(session, objectId)).get(name).nodeId;
    return (await session.call({ objectId, methodId, inputArguments: [] })).statusCode.name;
  }

  report.root = [...(await children(session, "i=14443")).keys()];
  const bridge = "bridge mobile_side";
  const writer = [bridge, "group-2", "speed"];
  report.publisherId = await read(bridge, "PublisherId");
  report.url = await read(bridge, "Address", "Url");
  report.writerId = await read(...writer, "DataSetWriterId");
  const metadata = await read("PublishedDataSets", bridge, "speed", "DataSetMetaData");
  report.metadata = {
    name: metadata.name,
    fields: metadata.fields.map((field) => [field.name, field.builtInType]),
    version: metadata.configurationVersion.majorVersion,
  };
  const target = await read("Fleet server", "readers-mobile_side", "ua_2_2_1001", "SubscribedDataSet", "TargetVariables");
  report.targets = target.map((one) => one.targetNodeId.toString());
  report.received = await read(
    "Fleet server", "readers-mobile_side", "Diagnostics", "Counters", "ReceivedNetworkMessages");
  report.states = [await read(...writer, "Status", "State")];
  report.calls = [];
  for (const name of ["Enable", "Disable", "Disable", "Enable"]) {
    report.calls.push(await call(name, ...writer));
    report.states.push(await read(...writer, "Status", "State"));
  }
});
