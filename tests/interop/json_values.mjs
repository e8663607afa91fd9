// Values as node-opcua-json writes them in its four schemes, and what it reads of values that it is given.
//
// Its standard input is a list of Variants in the VerboseEncoding; it prints one object: what it writes, by name and
// scheme, and what it has read, written again in its VerboseEncoding.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";
import { JsonEncodingScheme, opcuaJsonDecodeVariant, opcuaJsonEncodeDataValue, opcuaJsonEncodeVariant } from "node-opcua-json";

// The client of the other tests brings older packages of the same names: these are the ones that node-opcua-json has.
const beside = createRequire(import.meta.resolve("node-opcua-json"));
const load = (name) => import(pathToFileURL(beside.resolve(name)));
const { DataType, Variant, VariantArrayType } = await load("node-opcua-variant");
const { DataValue } = await load("node-opcua-data-value");
const { StatusCodes } = await load("node-opcua-status-code");
const { LocalizedText, QualifiedName } = await load("node-opcua-data-model");
const { coerceNodeId } = await load("node-opcua-nodeid");

const namespaces = ["http://opcfoundation.org/UA/", "urn:fleet"];
const { Array: ARRAY, Matrix: MATRIX, Scalar: SCALAR } = VariantArrayType;
const variants = {
    Boolean: { dataType: DataType.Boolean, value: true },
    SByte: { dataType: DataType.SByte, value: -2 },
    Byte: { dataType: DataType.Byte, value: 3 },
    Int16: { dataType: DataType.Int16, value: -4 },
    UInt16: { dataType: DataType.UInt16, value: 5 },
    Int32: { dataType: DataType.Int32, value: -6 },
    UInt32: { dataType: DataType.UInt32, value: 7 },
    Int64: { dataType: DataType.Int64, arrayType: SCALAR, value: [0x80000000, 0] },
    UInt64: { dataType: DataType.UInt64, arrayType: SCALAR, value: [0xffffffff, 0xffffffff] },
    Float: { dataType: DataType.Float, value: 0.5 },
    Double: { dataType: DataType.Double, value: -0.1 },
    Zero: { dataType: DataType.Double, value: 0 },
    String: { dataType: DataType.String, value: "水Boy" },
    DateTime: { dataType: DataType.DateTime, value: new Date("2024-01-17T21:20:00.123Z") },
    Guid: { dataType: DataType.Guid, value: "72962B91-FA75-4AE6-8D28-B404DC7DAF63" },
    ByteString: { dataType: DataType.ByteString, value: Buffer.from([0, 255]) },
    NodeId: { dataType: DataType.NodeId, value: coerceNodeId("ns=1;s=robot") },
    StatusCode: { dataType: DataType.StatusCode, value: StatusCodes.BadNoCommunication },
    QualifiedName: { dataType: DataType.QualifiedName, value: new QualifiedName({ namespaceIndex: 1, name: "Speed" }) },
    LocalizedText: { dataType: DataType.LocalizedText, value: new LocalizedText({ text: "text", locale: "en" }) },
    Doubles: { dataType: DataType.Double, arrayType: ARRAY, value: new Float64Array([1.5, 2.5]) },
    Texts: { dataType: DataType.String, arrayType: ARRAY, value: ["a", "b"] },
    Matrix: { dataType: DataType.Int32, arrayType: MATRIX, dimensions: [2, 3], value: new Int32Array([1, 2, 3, 4, 5, 6]) },
};
const dataValue = new DataValue({
    value: { dataType: DataType.Double, value: 1.5 },
    statusCode: StatusCodes.UncertainLastUsableValue,
    sourceTimestamp: new Date("2024-01-17T21:20:00Z"),
});
const schemes = ["Compact", "Verbose", "DeprecatedReversible", "DeprecatedNonReversible"];
const written = { DataValue: {} };
for (const scheme of schemes) {
    for (const [name, options] of Object.entries(variants)) {
        written[name] ??= {};
        written[name][scheme] = opcuaJsonEncodeVariant(new Variant(options), JsonEncodingScheme[scheme], namespaces);
    }
    written.DataValue[scheme] = opcuaJsonEncodeDataValue(dataValue, JsonEncodingScheme[scheme], namespaces);
}
const read = JSON.parse(readFileSync(0, "utf8")).map((text) => {
    const variant = new Variant(opcuaJsonDecodeVariant(text, undefined, namespaces));
    return opcuaJsonEncodeVariant(variant, JsonEncodingScheme.Verbose, namespaces);
});
console.log(JSON.stringify({ written, read }));
