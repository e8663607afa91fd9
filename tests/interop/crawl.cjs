// A foreign OPC UA client that reads every attribute of every node. Arguments: endpoint URL, user, password, folder
// for its certificates. Prints one JSON object: the number of nodes, how often each StatusCode, what could not be read,
// what is known of each kind of Variable with a Good value, supertypes, and which executable Methods of Objects are not there.
"use strict";

const { BrowseDirection, DataType, NodeClass, Variant, VariantArrayType } = require("node-opcua-client");
const foreign = require("./foreign.cjs");

const ATTRIBUTES = 27;
const [NODE_CLASS, VALUE, DATA_TYPE, VALUE_RANK, EXECUTABLE] = [2, 13, 14, 15, 21];
// Arguments that no Method takes: one that is there says so, and is not run.
const TOO_MANY = Array.from({ length: 40 }, () => new Variant({ dataType: DataType.Byte, value: 0 }));
const CALLED = new Set(["BadTooManyArguments", "BadUserAccessDenied"]);

const short = (nodeId) => nodeId.toString().replace(/^ns=0;/, "");

async function browsed(session, nodeIds, options) {
  const found = new Map(nodeIds.map((nodeId) => [nodeId, []]));
  let sources = nodeIds;
  let results = await session.browse(nodeIds.map((nodeId) => ({ nodeId, resultMask: 63, includeSubtypes: true, ...options })));
  while (results.length) {
    results.forEach((result, index) => found.get(sources[index]).push(...result.references));
    const left = results.map((result, index) => [sources[index], result.continuationPoint]);
    const points = left.filter(([, point]) => point && point.length);
    sources = points.map(([source]) => source);
    results = points.length ? await session.browseNext(points.map(([, point]) => point), false) : [];
  }
  return found;
}

async function crawl(session, root, options, visit) {
  const seen = new Set([root]);
  let open = [root];
  while (open.length) {
    const batch = open.splice(0, 200);
    for (const [source, references] of await browsed(session, batch, options)) {
      for (const reference of references) {
        const id = short(reference.nodeId);
        visit(source, reference, id);
        if (!seen.has(id)) {
          seen.add(id);
          open.push(id);
        }
      }
    }
  }
  return [...seen];
}

function variable(nodeId, values) {
  const [value, dataType, rank] = [VALUE, DATA_TYPE, VALUE_RANK].map((attribute) => values[attribute - 1]);
  const { arrayType, dimensions } = value.value;
  const isScalar = arrayType === VariantArrayType.Scalar;
  const depth = isScalar ? 0 : arrayType === VariantArrayType.Matrix ? dimensions.length : 1;
  const isNull = value.value.value === null || value.value.value === undefined;
  // A null String is a value of its type, as asyncua's client has it too.
  return [nodeId, short(dataType.value.value), rank.value.value, value.value.dataType, depth, isNull];
}

foreign.report(async (session, report) => {
  report.supertypes = {};
  const nodes = await crawl(session, "i=84", { browseDirection: BrowseDirection.Both }, (source, reference, id) => {
    const isSupertype = short(reference.referenceTypeId) === "i=45" && !reference.isForward;
    if (isSupertype && reference.nodeClass === NodeClass.DataType) report.supertypes[source] = id;
  });
  report.nodes = nodes.length;
  report.codes = {};
  report.failed = [];
  report.values = 0;
  const kinds = new Map(); // one of each kind says as much as all, in less output
  const executable = new Set();
  for (let at = 0; at < nodes.length; at += 200) {
    const batch = nodes.slice(at, at + 200);
    const wanted = batch.flatMap((nodeId) =>
      Array.from({ length: ATTRIBUTES }, (_, index) => ({ nodeId, attributeId: index + 1 })),
    );
    try {
      const values = await session.read(wanted);
      for (const { statusCode } of values) {
        report.codes[statusCode.name] = (report.codes[statusCode.name] || 0) + 1;
      }
      batch.forEach((nodeId, index) => {
        const own = values.slice(index * ATTRIBUTES, (index + 1) * ATTRIBUTES);
        if (own[VALUE - 1].statusCode.name === "Good") {
          const kind = variable(nodeId, own);
          report.values += 1;
          kinds.set(JSON.stringify(kind.slice(1)), kind);
        }
        if (own[NODE_CLASS - 1].value.value === NodeClass.Method && own[EXECUTABLE - 1].value.value) executable.add(nodeId);
      });
    } catch (error) {
      report.failed.push(`${batch[0]}: ${error.message}`);
    }
  }
  report.variables = [...kinds.values()];
  const calls = new Map();
  await crawl(session, "i=85", { browseDirection: BrowseDirection.Forward, referenceTypeId: "i=33" }, (source, reference, id) => {
    if (reference.nodeClass === NodeClass.Method && executable.has(id)) {
      calls.set(`${source} ${id}`, { objectId: source, methodId: id, inputArguments: TOO_MANY });
    }
  });
  const methods = [...calls.values()];
  report.methods = methods.length;
  const results = await session.call(methods.slice(0, 100));
  report.absent = methods
    .slice(0, 100)
    .filter((_, index) => !CALLED.has(results[index].statusCode.name))
    .map(({ objectId, methodId }) => `${objectId} ${methodId}`);
});
