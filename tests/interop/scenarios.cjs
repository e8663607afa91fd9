// A foreign OPC UA client runs a scenario: validates it, runs it, sees its events, ranks and confirms a replacement.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
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

const [endpointUrl, userName, password, folder] = process.argv.slice(2);
const FIELDS = ["EventType", "SourceNode", "Message", "Severity", "ActiveState.Id", "AckedState.Id", "Retain"];
const OWN = ["3:RunId", "3:State", "3:Fact", "3:Task", "3:Robot", "3:DecisionId", "3:DecisionState", "3:Robots", "3:Scores"];

const text = (value) => ({ dataType: DataType.String, value });
const texts = (value) => ({ dataType: DataType.String, arrayType: VariantArrayType.Array, value });

async function call(session, owner, name, ...inputArguments) {
  const objectId = `ns=2;s=Fleet.${owner}`;
  const result = await session.call({ objectId, methodId: `${objectId}.${name}`, inputArguments });
  if (result.statusCode.name !== "Good") throw new Error(`${name}: ${result.statusCode.name}`);
  const output = result.outputArguments.map((variant) => variant.value);
  return { output: output.slice(0, -2), message: output[output.length - 1] };
}

async function main() {
  const report = { events: [] };
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
    securityPolicy: SecurityPolicy.Basic256Sha256,
  });
  await client.connect(endpointUrl);
  const session = await client.createSession({ type: UserTokenType.UserName, userName, password });
  try {
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
      report.events.push({
        type: String(event.EventType),
        source: String(event.SourceNode),
        message: event.Message,
        active: event["ActiveState.Id"],
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
        const timer = setTimeout(() => reject(new Error(`not seen: ${fits}`)), 20000);
        const check = () => {
          const found = report.events.find(fits);
          if (found) {
            clearTimeout(timer);
            resolve(found);
          }
        };
        waiting.push(check);
        check();
      });

    report.listed = (await call(session, "Scenarios", "List")).output[0];
    const wrong = "version: 1\nname: w\nsteps:\n  - {task: a, skill: jump, robot: left}\n";
    report.problems = (await call(session, "Scenarios", "Validate", text(wrong))).output;
    report.problems[2] = Array.from(report.problems[2]);
    const [runId] = (await call(session, "Scenarios", "Run", text("two"), texts([]), texts([]))).output;
    report.runId = runId;
    await seen((event) => event.fact === "TaskOver" && event.task === "first");
    await call(session, "Faults", "RaiseFault", text("left"), text("gripper stuck"));
    const open = await seen((event) => event.decisionState === "open");
    report.confirmed = (await call(session, "Resilience", "Confirm", text(open.decision), text("right"))).output;
    report.refused = (await call(session, "Resilience", "Confirm", text(open.decision), text("middle"))).message;
    await seen((event) => event.run === runId && event.state === "done");
    const states = await session.read({
      nodeId: `ns=2;s=Fleet.Scenarios.Runs.${runId}.Robots`,
      attributeId: AttributeIds.Value,
    });
    report.robots = states.value.value;
    await subscription.terminate();
  } finally {
    await session.close();
    await client.disconnect();
  }
  await clientCertificateManager.dispose();
  console.log(JSON.stringify(report));
}

main().then(
  () => process.exit(0),
  (error) => {
    console.error(error.stack);
    process.exit(1);
  },
);
