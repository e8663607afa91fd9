// The server of the benchmark `services` in node-opcua: the same nodes as the others have.
// Arguments: port, certificate, private key, folder for its list of trusted certificates.
// Answers each line with the CPU seconds of its process.
"use strict";

const {
  DataType,
  MessageSecurityMode,
  SecurityPolicy,
  StatusCodes,
} = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const { OPCUAServer } = require("node-opcua-server");

// The library writes its warnings there, too.
console.log = console.warn = console.error;

function say(text) {
  process.stdout.write(`${text}\n`);
}

const [port, certificateFile, privateKeyFile, folder] = process.argv.slice(2);
const VALUES = 1000;
const IN_FOLDER = 100;

function addNodes(addressSpace) {
  const namespace = addressSpace.registerNamespace("urn:ua-fleet:fleet");
  let parent = addressSpace.rootFolder.objects;
  for (let number = 1; number <= VALUES; number += 1) {
    if (number % IN_FOLDER === 1) {
      const name = `G${Math.floor(number / IN_FOLDER)}`;
      parent = namespace.addFolder(addressSpace.rootFolder.objects, { browseName: name, nodeId: `s=${name}` });
    }
    const variable = namespace.addVariable({
      componentOf: parent,
      browseName: `value${number}`,
      nodeId: `i=${number}`,
      dataType: DataType.Double,
      accessLevel: "CurrentRead | CurrentWrite",
      userAccessLevel: "CurrentRead | CurrentWrite",
    });
    variable.setValueFromSource({ dataType: DataType.Double, value: 1.5 });
  }
  const owner = namespace.addObject({
    organizedBy: addressSpace.rootFolder.objects,
    browseName: "Owner",
    nodeId: "s=Owner",
  });
  const method = namespace.addMethod(owner, { browseName: "Method", nodeId: "s=Method" });
  method.bindMethod((_inputs, _context, callback) => {
    callback(null, { statusCode: StatusCodes.Good, outputArguments: [] });
  });
}

async function main() {
  const trusts = new OPCUACertificateManager({ automaticallyAcceptUnknownCertificate: true, rootFolder: folder });
  await trusts.initialize();
  const server = new OPCUAServer({
    port: Number(port),
    resourcePath: "/ua_fleet",
    certificateFile,
    privateKeyFile,
    serverCertificateManager: trusts,
    serverInfo: { applicationUri: "urn:ua-fleet:benchmark" },
    securityPolicies: [SecurityPolicy.None, SecurityPolicy.Basic256Sha256],
    securityModes: [MessageSecurityMode.None, MessageSecurityMode.SignAndEncrypt],
    userManager: { isValidUser: () => true },
    serverCapabilities: { maxSessions: 100, operationLimits: { maxNodesPerRead: 10000, maxNodesPerWrite: 10000 } },
  });
  await server.initialize();
  addNodes(server.engine.addressSpace);
  await server.start();
  say("ready");
  let rest = "";
  process.stdin.on("data", (data) => {
    const lines = (rest + data).split("\n");
    rest = lines.pop();
    for (const _line of lines) {
      const { user, system } = process.cpuUsage();
      say((user + system) / 1e6);
    }
  });
  process.stdin.on("end", () => process.exit(0));
}

main();
