"""Which built-in type a DataType has, from the descriptions of the metadata and from what the specification defines."""

from __future__ import annotations

from typing import Final, NamedTuple

from ua_fleet.values import BuiltinType, NodeId, QualifiedName
from ua_fleet.wire.descriptions import EnumerationDescription, StructureDescription, StructureField
from ua_fleet.wire.messages import DataSetMetaData

__all__ = ["NO_TYPES", "DataTypes", "Resolved"]

_B = BuiltinType

_SUBTYPES: Final[dict[int, int]] = {
    26: _B.VARIANT,  # Number
    27: _B.VARIANT,  # Integer
    28: _B.VARIANT,  # UInteger
    29: _B.INT32,  # Enumeration
    30: _B.BYTE_STRING,  # Image
    120: _B.INT32,  # NamingRuleType
    256: _B.INT32,  # IdType
    257: _B.INT32,  # NodeClass
    288: _B.UINT32,  # IntegerId
    289: _B.UINT32,  # Counter
    290: _B.DOUBLE,  # Duration
    291: _B.STRING,  # NumericRange
    292: _B.STRING,  # Time
    293: _B.DATETIME,  # Date
    294: _B.DATETIME,  # UtcTime
    295: _B.STRING,  # LocaleId
    302: _B.INT32,  # MessageSecurityMode
    307: _B.INT32,  # ApplicationType
    311: _B.BYTE_STRING,  # ApplicationInstanceCertificate
    388: _B.NODE_ID,  # SessionAuthenticationToken
    521: _B.BYTE_STRING,  # ContinuationPoint
    852: _B.INT32,  # ServerState
    14647: _B.INT32,  # PubSubState
    20998: _B.UINT32,  # VersionTime
}
"""Built-in types of DataTypes of namespace 0 that are subtypes of one (OPC 10000-5 12)."""


def _standard(
    data_type: int, encoding: int, name: str, *fields: tuple[str, int]
) -> tuple[NodeId, StructureDescription]:
    members = tuple([StructureField(member, NodeId(0, kind)) for member, kind in fields])
    known = NodeId(0, data_type)
    return known, StructureDescription(known, QualifiedName(0, name), members, default_encoding=NodeId(0, encoding))


_STANDARD: Final = dict(
    [
        _standard(884, 886, "Range", ("Low", _B.DOUBLE), ("High", _B.DOUBLE)),
        _standard(
            887,
            889,
            "EUInformation",
            ("NamespaceUri", _B.STRING),
            ("UnitId", _B.INT32),
            ("DisplayName", _B.LOCALIZED_TEXT),
            ("Description", _B.LOCALIZED_TEXT),
        ),
        _standard(12755, 12765, "OptionSet", ("Value", _B.BYTE_STRING), ("ValidBits", _B.BYTE_STRING)),
    ]
)
"""Structures that properties of fields have, and that option sets are made of."""


class Resolved(NamedTuple):
    """What a DataType is made of."""

    kind: int
    """The built-in type."""
    structure: StructureDescription | None = None
    names: dict[int, str] | None = None
    """Of an enumeration, as far as they are known; None for another type."""


def _resolved(enumeration: EnumerationDescription) -> Resolved:
    if enumeration.builtin_type == _B.INT32:
        return Resolved(_B.INT32, None, {field.value: field.name for field in enumeration.fields})
    return Resolved(enumeration.builtin_type)  # an option set is its number


class DataTypes:
    """The DataTypes of one metadata."""

    __slots__ = ("_encodings", "_enumerations", "_simple", "_structures")

    def __init__(self, metadata: DataSetMetaData | None = None) -> None:
        """Index the descriptions of a metadata."""
        structures = () if metadata is None else metadata.structures
        self._structures = _STANDARD | {description.data_type: description for description in structures}
        self._encodings = {
            description.default_encoding: description
            for description in self._structures.values()
            if description.default_encoding != NodeId(0, 0)
        }
        # Made once: each field keeps what its DataType resolves to, and names may be many.
        self._enumerations: dict[NodeId, Resolved] = (
            {}
            if metadata is None
            else {described.data_type: _resolved(described) for described in metadata.enumerations}
        )
        self._simple: dict[NodeId, int] = (
            {} if metadata is None else {simple.data_type: simple.builtin_type for simple in metadata.simple_types}
        )

    def structure(self, type_id: NodeId) -> StructureDescription | None:
        """The description of a structure, by its DataType or by its Default Binary encoding."""
        return self._structures.get(type_id) or self._encodings.get(type_id)

    def resolve(self, data_type: NodeId) -> Resolved | None:
        """The built-in type of a DataType; None for one that is not described."""
        if data_type in self._structures:
            return Resolved(_B.EXTENSION_OBJECT, self._structures[data_type])
        enumeration = self._enumerations.get(data_type)
        if enumeration is not None:
            return enumeration
        simple = self._simple.get(data_type)
        if simple is not None:
            return Resolved(simple)
        namespace, number = data_type
        if namespace == 0 and isinstance(number, int):
            if _B.BOOLEAN <= number <= _B.DIAGNOSTIC_INFO:
                return Resolved(number)
            kind = _SUBTYPES.get(number)
            if kind is not None:
                return Resolved(kind, None, {} if kind == _B.INT32 else None)
        return None


NO_TYPES: Final = DataTypes()
