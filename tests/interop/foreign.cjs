// What the foreign OPC UA clients have in common: a session, a report, Methods with plain arguments, events.
"use strict";

const {
  AttributeIds,
  constructEventFilter,
  DataType,
  MessageSecurityMode,
  OPCUAClient,
  SecurityPolicy,
  TimestampsToReturn,
  UserTokenType,
  VariantArrayType,
} = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");

const FIELDS = ["EventType", "SourceNode", "Message", "Severity", "ActiveState.Id", "AckedState.Id", "Retain", "EventId"];
const OWN = ["3:RunId", "3:State", "3:Fact", "3:Task", "3:Robot", "3:DecisionId", "3:DecisionState", "3:Robots", "3:Scores"];

const text = (value) => ({ dataType: DataType.String, value });
const texts = (value) => ({ dataType: DataType.String, arrayType: VariantArrayType.Array, value });

// Calls a Method of Scenarios, Resilience or Faults; its outputs without the last two, ReturnStatus and Message.
async function call(session, owner, name, ...inputArguments) {
  const objectId = `ns=2;s=Fleet.${owner}`;
  const result = await session.call({ objectId, methodId: `${objectId}.${name}`, inputArguments });
  if (result.statusCode.name !== "Good") throw new Error(`${name}: ${result.statusCode.name}`);
  const output = result.outputArguments.map((variant) => variant.value);
  return { output: output.slice(0, -2), message: output[output.length - 1] };
}

// Subscribes to the Server's events: each goes into `events`; `seen` waits for the first that fits.
async function watchEvents(session, events, timeoutMs) {
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50,
    requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 10,
    publishingEnabled: true,
  });
  const item = await subscription.monitor(
    { nodeId: "i=2253", attributeId: AttributeIds.EventNotifier },
    { samplingInterval: 0, queueSize: 1000, discardOldest: true, filter: constructEventFilter([...FIELDS, ...OWN]) },
    TimestampsToReturn.Both,
  );
  const waiting = [];
  item.on("changed", (fields) => {
    const event = {};
    [...FIELDS, ...OWN].forEach((name, index) => {
      const value = fields[index].value;
      event[name] = value && value.text !== undefined ? value.text : value;
    });
    events.push({
      type: String(event.EventType),
      source: String(event.SourceNode),
      message: event.Message,
      active: event["ActiveState.Id"],
      acknowledged: event["AckedState.Id"],
      id: event.EventId ? event.EventId.toString("hex") : null,
      run: event["3:RunId"],
      state: event["3:State"],
      fact: event["3:Fact"],
      task: event["3:Task"],
      robot: event["3:Robot"],
      decision: event["3:DecisionId"],
      decisionState: event["3:DecisionState"],
      robots: event["3:Robots"],
      scores: Array.from(event["3:Scores"] || []),
    });
    waiting.slice().forEach((check) => check());
  });
  const seen = (fits) =>
    new Promise((resolve, reject) => {
      const timer = setTimeout(() => reject(new Error(`not seen: ${fits}`)), timeoutMs);
      const check = () => {
        const found = events.find(fits);
        if (found) {
          clearTimeout(timer);
          resolve(found);
        }
      };
      waiting.push(check);
      check();
    });
  return { seen, end: () => subscription.terminate() };
}

// Has a session over an encrypted connection. `identity` is who logs in, `options` are further ones of the client.
async function inSession(endpointUrl, folder, identity, options, work) {
  const clientCertificateManager = new OPCUACertificateManager({
    rootFolder: folder,
    automaticallyAcceptUnknownCertificate: true,
  });
  await clientCertificateManager.initialize();
  const client = OPCUAClient.create({
    applicationName: "foreign",
    clientCertificateManager,
    connectionStrategy: { maxRetry: 1, initialDelay: 100 },
    endpointMustExist: true,
    securityMode: MessageSecurityMode.SignAndEncrypt,
    ...options,
  });
  await client.connect(endpointUrl);
  const session = await client.createSession(identity);
  try {
    await work(session);
  } finally {
    await session.close();
    await client.disconnect();
  }
  await clientCertificateManager.dispose();
}

// The same as the program's arguments say: endpoint URL, user, password, folder for its certificates.
function withSession(work) {
  const [endpointUrl, userName, password, folder] = process.argv.slice(2);
  const identity = { type: UserTokenType.UserName, userName, password };
  return inSession(endpointUrl, folder, identity, { securityPolicy: SecurityPolicy.Basic256Sha256 }, work);
}

// Ends the program with what was made, as one JSON object, or with the error.
function ended(work) {
  work.then(
    (made) => {
      console.log(JSON.stringify(made));
      process.exit(0);
    },
    (error) => {
      console.error(error.stack);
      process.exit(1);
    },
  );
}

// Runs a program that makes a report, and prints it.
function report(work) {
  const made = { events: [] };
  ended(withSession((session) => work(session, made)).then(() => made));
}

async function readValue(session, nodeId) {
  return (await session.read({ nodeId, attributeId: AttributeIds.Value })).value.value;
}

module.exports = { call, ended, inSession, readValue, report, text, texts, watchEvents };
