// A foreign OPC UA client that reads the summaries of robots: their structure it learns from the server alone.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const { AttributeIds } = require("node-opcua-client");
const { resolveDynamicExtensionObject } = require("node-opcua-client-dynamic-extension-object");
const foreign = require("./foreign.cjs");

foreign.report(async (session, report) => {
  const types = await session.extractNamespaceDataType();
  const folder = await session.browse("ns=2;s=Fleet.Summaries");
  const nodes = folder.references.filter((ref) => ref.isForward && ref.nodeId.namespace === 2).map((ref) => ref.nodeId);
  report.groups = [];
  for (const nodeId of nodes) {
    const { value, statusCode } = await session.read({ nodeId, attributeId: AttributeIds.Value });
    if (statusCode.name !== "Good") throw new Error(`${nodeId}: ${statusCode.name}`);
    await resolveDynamicExtensionObject(session, value, types);
    report.groups.push(
      value.value.map((robot) => ({
        type: robot.schema.name,
        name: robot.name,
        state: robot.state,
        stateSince: robot.stateSince.toISOString(),
        quality: robot.quality.name,
        lastUpdate: robot.lastUpdate ? robot.lastUpdate.toISOString() : null,
        task: robot.task,
        runId: robot.runId,
        held: robot.held,
        heldBy: robot.heldBy,
        heldReason: robot.heldReason,
        faults: robot.faults,
        fault: robot.fault,
        bridge: robot.bridge,
        capacities: Array.from(robot.capacities),
      })),
    );
  }
});
