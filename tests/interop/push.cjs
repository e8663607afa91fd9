// A foreign key service: an OPC UA client that pushes keys to a server (SetSecurityKeys), as a user with a password.
// Arguments: endpoint URL, ApplicationUri, certificate (PEM), private key (PEM), folder for its certificates, user,
// password, SecurityPolicyUri, keys as hexadecimal separated by commas, groups...
// Prints one JSON object: the StatusCodes by group.
"use strict";

const { DataType, SecurityPolicy, UserTokenType, VariantArrayType } = require("node-opcua-client");
const { ended, inSession } = require("./foreign.cjs");

const [endpointUrl, applicationUri, certificateFile, privateKeyFile, folder, userName, password, policy, hex, ...groups] =
  process.argv.slice(2);
const [current, ...future] = hex.split(",").map((key) => Buffer.from(key, "hex"));

async function main() {
  const identity = { type: UserTokenType.UserName, userName, password };
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
        methodId: "i=17364",
        inputArguments: [
          { dataType: DataType.String, value: group },
          { dataType: DataType.String, value: policy },
          { dataType: DataType.UInt32, value: 5 },
          { dataType: DataType.ByteString, value: current },
          { dataType: DataType.ByteString, arrayType: VariantArrayType.Array, value: future },
          { dataType: DataType.Double, value: 40000 },
          { dataType: DataType.Double, value: 100000 },
        ],
      });
      report[group] = result.statusCode.name;
    }
  });
  return report;
}

ended(main());
