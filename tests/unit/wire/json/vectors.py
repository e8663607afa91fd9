"""JSON texts beside the values that they stand for, in both directions (OPC 10000-6 5.4.2)."""

from __future__ import annotations

import math
from typing import Any
from uuid import UUID

from ua_fleet.values import (
    DataValue,
    DiagnosticInfo,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    Variant,
)

GUID = UUID("72962b91-fa75-4ae6-8d28-b404dc7daf63")
NAMESPACES = ("urn:fleet", "urn:semi;colon%")
"""Indices 1 and 2."""

SCALARS: list[tuple[int, Any, Any]] = [
    (1, True, True),
    (2, -128, -128),
    (3, 255, 255),
    (4, -32768, -32768),
    (5, 65535, 65535),
    (6, -2147483648, -2147483648),
    (7, 4294967295, 4294967295),
    (8, -9223372036854775808, "-9223372036854775808"),
    (9, 18446744073709551615, "18446744073709551615"),
    (10, 0.5, 0.5),
    (11, -0.1, -0.1),
    (11, math.inf, "Infinity"),
    (11, -math.inf, "-Infinity"),
    (12, "水Boy", "水Boy"),
    (12, None, None),
    (13, 133_500_000_000_000_000, "2024-01-17T21:20:00Z"),
    (13, 133_500_000_000_000_001, "2024-01-17T21:20:00.0000001Z"),
    (13, 0, "0001-01-01T00:00:00Z"),
    (13, 0x7FFF_FFFF_FFFF_FFFF, "9999-12-31T23:59:59Z"),
    (14, GUID, "72962b91-fa75-4ae6-8d28-b404dc7daf63"),
    (15, b"\0\xff", "AP8="),
    (15, None, None),
    (16, "<a/>", "<a/>"),
    (17, NodeId(0, 13), "i=13"),
    (17, NodeId(0, 0), None),
    (17, NodeId(1, "robot;1"), "nsu=urn:fleet;s=robot;1"),
    (17, NodeId(2, GUID), "nsu=urn:semi%3Bcolon%25;g=72962b91-fa75-4ae6-8d28-b404dc7daf63"),
    (17, NodeId(7, b"\1"), "ns=7;b=AQ=="),
    (18, ExpandedNodeId(NodeId(0, 7), "urn:other", 3), "svr=3;nsu=urn:other;i=7"),
    (18, ExpandedNodeId(NodeId(1, 7)), "nsu=urn:fleet;i=7"),
    (18, ExpandedNodeId(NodeId(0, 0)), None),
    (19, 0x8031_0000, {"Code": 0x8031_0000, "Symbol": "BadNoCommunication"}),
    (19, 0x80FF_0000, {"Code": 0x80FF_0000}),
    (19, 0, {}),
    (20, QualifiedName(0, "Speed"), "Speed"),
    (20, QualifiedName(1, "Speed"), "nsu=urn:fleet;Speed"),
    (20, QualifiedName(9, "Speed"), "9:Speed"),
    (20, QualifiedName(0, "9:Speed"), "0:9:Speed"),
    (20, QualifiedName(0, None), None),
    (21, LocalizedText("text", "en"), {"Locale": "en", "Text": "text"}),
    (21, LocalizedText(None), {}),
    (
        22,
        ExtensionObject(NodeId(1, 70_000), b"body"),
        {"UaTypeId": "nsu=urn:fleet;i=70000", "UaEncoding": 1, "UaBody": "Ym9keQ=="},
    ),
    (
        22,
        ExtensionObject(NodeId(1, 70_000), "<a/>"),
        {"UaTypeId": "nsu=urn:fleet;i=70000", "UaEncoding": 2, "UaBody": "PGEvPg=="},
    ),
    (
        23,
        DataValue(Variant(12, "x"), 0x4000_0000, 133_500_000_000_000_000, None, 3, None),
        {
            "UaType": 12,
            "Value": "x",
            "Status": {"Code": 0x4000_0000, "Symbol": "Uncertain"},
            "SourceTimestamp": "2024-01-17T21:20:00Z",
            "SourcePicoseconds": 3,
        },
    ),
    (23, DataValue(None), {}),
    (
        25,
        DiagnosticInfo(1, 2, 3, 4, "info", 0x8031_0000, DiagnosticInfo(6)),
        {
            "SymbolicId": 1,
            "NamespaceUri": 2,
            "LocalizedText": 3,
            "Locale": 4,
            "AdditionalInfo": "info",
            "InnerStatusCode": {"Code": 0x8031_0000},
            "InnerDiagnosticInfo": {"SymbolicId": 6},
        },
    ),
]
"""(built-in type, value, JSON in the VerboseEncoding)"""

VARIANTS: list[tuple[Variant, Any]] = [
    (Variant(0, None), None),
    (Variant(6, -6), {"UaType": 6, "Value": -6}),
    (Variant(12, None), {"UaType": 12}),
    (Variant(0x8B, ()), {"UaType": 11, "Value": []}),
    (Variant(0x8B, (1.0, math.inf)), {"UaType": 11, "Value": [1.0, "Infinity"]}),
    (Variant(0x8C, ("a", None)), {"UaType": 12, "Value": ["a", None]}),
    (
        Variant(0x93, (0, 0x8031_0000)),
        {"UaType": 19, "Value": [{}, {"Code": 0x8031_0000, "Symbol": "BadNoCommunication"}]},
    ),
    (
        Variant(0xC6, Matrix((1, 2, 3, 4, 5, 6), (2, 3))),
        {"UaType": 6, "Value": [1, 2, 3, 4, 5, 6], "Dimensions": [2, 3]},
    ),
    (
        Variant(0x98, (Variant(3, 1), Variant(0x8C, ("x",)))),
        {"UaType": 24, "Value": [{"UaType": 3, "Value": 1}, {"UaType": 12, "Value": ["x"]}]},
    ),
]
