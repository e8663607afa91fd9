// A foreign OPC UA client that reads every attribute of every node. Arguments: endpoint URL, user, password, folder
// for its certificates. Prints one JSON object: the number of nodes, how often each StatusCode, what could not be read.
"use strict";

const { BrowseDirection } = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const ATTRIBUTES = 27;

async function crawl(session) {
  const seen = new Set(["i=84"]);
  let open = [...seen];
  while (open.length) {
    const batch = open.splice(0, 200);
    let results = await session.browse(
      batch.map((nodeId) => ({ nodeId, browseDirection: BrowseDirection.Both, includeSubtypes: true, resultMask: 63 })),
    );
    while (results.length) {
      for (const result of results) {
        for (const { nodeId } of result.references) {
          const id = nodeId.toString();
          if (!seen.has(id)) {
            seen.add(id);
            open.push(id);
          }
        }
      }
      const points = results.map((result) => result.continuationPoint).filter((point) => point && point.length);
      results = points.length ? await session.browseNext(points, false) : [];
    }
  }
  return [...seen];
}

foreign.report(async (session, report) => {
  const nodes = await crawl(session);
  report.nodes = nodes.length;
  report.codes = {};
  report.failed = [];
  const wanted = nodes.flatMap((nodeId) =>
    Array.from({ length: ATTRIBUTES }, (_, index) => ({ nodeId, attributeId: index + 1 })),
  );
  for (let at = 0; at < wanted.length; at += 5000) {
    const batch = wanted.slice(at, at + 5000);
    try {
      for (const { statusCode } of await session.read(batch)) {
        report.codes[statusCode.name] = (report.codes[statusCode.name] || 0) + 1;
      }
    } catch (error) {
      report.failed.push(`${batch[0].nodeId}: ${error.message}`);
    }
  }
});
