// A foreign OPC UA client that fetches keys as a bridge does: with its own certificate as application and as user.
// Arguments: endpoint URL, ApplicationUri, certificate (PEM), private key (PEM), folder for its certificates, groups...
// Prints one JSON object: the answers by group.
"use strict";

const fs = require("node:fs");
const {
  DataType,
  MessageSecurityMode,
  OPCUAClient,
  SecurityPolicy,
  UserTokenType,
  VariantArrayType,
} = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");

const [endpointUrl, applicationUri, certificateFile, privateKeyFile, folder, ...groups] = process.argv.slice(2);

async function main() {
  const clientCertificateManager = new OPCUACertificateManager({
    rootFolder: folder,
    automaticallyAcceptUnknownCertificate: true,
  });
  await clientCertificateManager.initialize();
  const client = OPCUAClient.create({
    applicationName: "foreign",
    applicationUri,
    certificateFile,
    privateKeyFile,
    clientCertificateManager,
    connectionStrategy: { maxRetry: 1, initialDelay: 100 },
    endpointMustExist: true,
    securityMode: MessageSecurityMode.SignAndEncrypt,
    securityPolicy: SecurityPolicy.Aes256_Sha256_RsaPss,
  });
  await client.connect(endpointUrl);
  const pem = fs.readFileSync(certificateFile, "latin1");
  const certificateData = Buffer.from(pem.replace(/-----[^-]+-----|\s/g, ""), "base64");
  const privateKey = fs.readFileSync(privateKeyFile, "utf8");
  const session = await client.createSession({ type: UserTokenType.Certificate, certificateData, privateKey });
  const report = {};
  try {
    for (const group of groups) {
      const result = await session.call({
        objectId: "i=14443",
        methodId: "i=15215",
        inputArguments: [
          { dataType: DataType.String, value: group },
          { dataType: DataType.UInt32, value: 0 },
          { dataType: DataType.UInt32, value: 3 },
        ],
      });
      report[group] = {
        status: result.statusCode.name,
        types: (result.outputArguments || []).map((variant) => DataType[variant.dataType]),
        isArray: (result.outputArguments || []).map((variant) => variant.arrayType === VariantArrayType.Array),
        values: (result.outputArguments || []).map(({ value }) =>
          Array.isArray(value) ? value.map((key) => key.toString("hex")) : value,
        ),
      };
    }
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
