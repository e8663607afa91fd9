// A foreign OPC UA client that reads every PubSubConnection below PublishSubscribe, with its groups and what these hold.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const { AttributeIds, BrowseDirection } = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const HIERARCHICAL = "i=33";
const HAS_CONNECTION = "i=14476";
const TYPES = { group: ["ns=0;i=17725", "ns=0;i=17999"], member: ["ns=0;i=15298", "ns=0;i=15306"] };

async function browse(session, nodeId, referenceTypeId) {
  const found = await session.browse({
    nodeId,
    referenceTypeId,
    includeSubtypes: true,
    browseDirection: BrowseDirection.Forward,
    resultMask: 63,
  });
  return found.references;
}

async function read(session, top, ...names) {
  let nodeId = top;
  for (const name of names) {
    const next = (await browse(session, nodeId, HIERARCHICAL)).find((one) => one.browseName.name === name);
    if (!next) return null;
    nodeId = next.nodeId;
  }
  const answer = await session.read({ nodeId, attributeId: AttributeIds.Value });
  return answer.statusCode.name === "Good" ? answer.value.value : answer.statusCode.name;
}

async function typed(session, nodeId, types) {
  const found = await browse(session, nodeId, HIERARCHICAL);
  return found.filter((one) => types.includes(one.typeDefinition.toString()));
}

foreign.report(async (session, report) => {
  report.connections = {};
  for (const connection of await browse(session, "i=14443", HAS_CONNECTION)) {
    const id = connection.nodeId;
    const groups = {};
    for (const group of await typed(session, id, TYPES.group)) {
      groups[group.browseName.name] = {};
      for (const member of await typed(session, group.nodeId, TYPES.member)) {
        groups[group.browseName.name][member.browseName.name] = await read(session, member.nodeId, "Status", "State");
      }
    }
    report.connections[connection.browseName.name] = {
      url: await read(session, id, "Address", "Url"),
      profile: await read(session, id, "TransportProfileUri"),
      state: await read(session, id, "Status", "State"),
      errors: await read(session, id, "Diagnostics", "Counters", "StateError"),
      groups,
    };
  }
});
