// A foreign OPC UA client that fetches keys as a bridge does: with its own certificate as application and as user.
// Arguments: endpoint URL, ApplicationUri, certificate (PEM), private key (PEM), folder for its certificates, groups...
// Prints one JSON object: the answers by group.
"use strict";

const fs = require("node:fs");
const {
  DataType,
  SecurityPolicy,
  UserTokenType,
  VariantArrayType,
} = require("node-opcua-client");
const { ended, inSession } = require("./foreign.cjs");

const [endpointUrl, applicationUri, certificateFile, privateKeyFile, folder, ...groups] = process.argv.slice(2);

async function main() {
  const pem = fs.readFileSync(certificateFile, "latin1");
  const certificateData = Buffer.from(pem.replace(/-----[^-]+-----|\s/g, ""), "base64");
  const privateKey = fs.readFileSync(privateKeyFile, "utf8");
  const identity = { type: UserTokenType.Certificate, certificateData, privateKey };
  const options = {
    applicationUri,
    certificateFile,
    privateKeyFile,
    securityPolicy: SecurityPolicy.Aes256_Sha256_RsaPss,
  };
  const report = {};
  await inSession(endpointUrl, folder, identity, options, async (session) => {
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
  });
  return report;
}

ended(main());
