"""The structures of discovery as bytes (OPC 10000-14 6.2 and 6.3, OPC 10000-4 7): tables of their fields.

The numbers are those of the structures' Default Binary encodings in namespace 0 (OPC 10000-6 annex A).
"""

from __future__ import annotations

from typing import Final

from ua_fleet.wire import discovered as d
from ua_fleet.wire.metadata import decode_metadata, encode_metadata
from ua_fleet.wire.structure import (
    BOOLEAN,
    BYTE,
    BYTE_STRING,
    DOUBLE,
    ENUMERATION,
    LOCALIZED_TEXT,
    NODE_ID,
    QUALIFIED_NAME,
    STRING,
    TEXT,
    UINT16,
    UINT32,
    VARIANT,
    Shape,
    array,
    extension,
    structure,
)

__all__ = [
    "ACTION_METHOD",
    "ACTION_TARGET",
    "APPLICATION_DESCRIPTION",
    "CONNECTION",
    "ENDPOINT_DESCRIPTION",
    "META_DATA",
    "WRITER_GROUP",
]

SMALLEST_META_DATA: Final = 49

META_DATA: Final = Shape(SMALLEST_META_DATA, decode_metadata, encode_metadata)

PROPERTIES: Final = array(structure(d.KeyValuePair, QUALIFIED_NAME, VARIANT))

APPLICATION_DESCRIPTION: Final = structure(
    d.ApplicationDescription, STRING, STRING, LOCALIZED_TEXT, ENUMERATION, STRING, STRING, array(TEXT)
)

USER_TOKEN_POLICY: Final = structure(d.UserTokenPolicy, STRING, ENUMERATION, STRING, STRING, STRING)

ENDPOINT_DESCRIPTION: Final = structure(
    d.EndpointDescription,
    STRING,
    APPLICATION_DESCRIPTION,
    BYTE_STRING,
    ENUMERATION,
    STRING,
    array(USER_TOKEN_POLICY),
    STRING,
    BYTE,
)

ADDRESS: Final = extension({21152: (d.NetworkAddressUrl, structure(d.NetworkAddressUrl, STRING, STRING))})

CONNECTION_TRANSPORT: Final = extension(
    {
        23864: (
            d.DatagramConnectionTransport,
            structure(d.DatagramConnectionTransport, ADDRESS, UINT32, UINT32, STRING, array(extension())),
        )
    }
)

WRITER_MESSAGE: Final = extension(
    {
        15717: (d.UadpDataSetWriterMessage, structure(d.UadpDataSetWriterMessage, UINT32, UINT16, UINT16, UINT16)),
        15724: (d.JsonDataSetWriterMessage, structure(d.JsonDataSetWriterMessage, UINT32)),
    }
)

GROUP_MESSAGE: Final = extension(
    {
        15715: (
            d.UadpWriterGroupMessage,
            structure(d.UadpWriterGroupMessage, UINT32, ENUMERATION, UINT32, DOUBLE, array(DOUBLE)),
        ),
        15719: (d.JsonWriterGroupMessage, structure(d.JsonWriterGroupMessage, UINT32)),
    }
)

DATA_SET_WRITER: Final = structure(
    d.DataSetWriter,
    STRING,
    BOOLEAN,
    UINT16,
    UINT32,
    UINT32,
    STRING,
    PROPERTIES,
    extension(),
    WRITER_MESSAGE,
)

GROUP: Final = (STRING, BOOLEAN, ENUMERATION, STRING, array(ENDPOINT_DESCRIPTION), UINT32, PROPERTIES)
"""PubSubGroupDataType, from which both kinds of groups inherit."""

WRITER_GROUP: Final = structure(
    d.WriterGroup,
    *GROUP,
    UINT16,
    DOUBLE,
    DOUBLE,
    BYTE,
    array(TEXT),
    STRING,
    extension(),
    GROUP_MESSAGE,
    array(DATA_SET_WRITER),
)

DATA_SET_READER: Final = structure(
    d.DataSetReader,
    STRING,
    BOOLEAN,
    VARIANT,
    UINT16,
    UINT16,
    META_DATA,
    UINT32,
    DOUBLE,
    UINT32,
    STRING,
    ENUMERATION,
    STRING,
    array(ENDPOINT_DESCRIPTION),
    PROPERTIES,
    extension(),
    extension(),
    extension(),
)

READER_GROUP: Final = structure(d.ReaderGroup, *GROUP, extension(), extension(), array(DATA_SET_READER))

CONNECTION: Final = structure(
    d.PubSubConnection,
    STRING,
    BOOLEAN,
    VARIANT,
    STRING,
    ADDRESS,
    PROPERTIES,
    CONNECTION_TRANSPORT,
    array(WRITER_GROUP),
    array(READER_GROUP),
)

ACTION_TARGET: Final = structure(d.ActionTarget, UINT16, STRING, LOCALIZED_TEXT)

ACTION_METHOD: Final = structure(d.ActionMethod, NODE_ID, NODE_ID)
