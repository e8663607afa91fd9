"""NodeId, ExpandedNodeId and QualifiedName as text (OPC 10000-6 5.1.12, 5.4.2.10, 5.4.2.11, 5.4.2.14).

    NodeId           i=13    nsu=urn:fleet;s=robot    ns=5;i=7 where the namespace has no known URI
    ExpandedNodeId   the same, with svr=<index>; before it where another server has the node
    QualifiedName    Speed   nsu=urn:fleet;Speed      5:Speed where the namespace has no known URI

The older forms, objects with `Id` or `Name`, are read (OPC 10000-6 H.2, H.3, H.5).
"""

from __future__ import annotations

import binascii
import re
import uuid
from typing import Any, Final, cast
from urllib.parse import unquote

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ExpandedNodeId, NodeId, QualifiedName
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.parsing import Reading, shown

__all__ = [
    "NULL_NODE_ID",
    "decode_expanded_node_id",
    "decode_node_id",
    "decode_qualified_name",
    "encode_expanded_node_id",
    "encode_node_id",
    "encode_qualified_name",
]

NULL_NODE_ID: Final = NodeId(0, 0)
NULL_NAME: Final = QualifiedName(0, None)

_UA_NAMESPACE: Final = "http://opcfoundation.org/UA/"
_SERVER: Final = re.compile(r"svr=(\d{1,10});", re.ASCII)
_NAMESPACE: Final = re.compile(r"(?:ns=(\d{1,5})|nsu=([^;]*));", re.ASCII)
_NAME_INDEX: Final = re.compile(r"(\d{1,5}):", re.ASCII)
_GUID: Final = re.compile(r"[0-9A-Fa-f]{8}(?:-[0-9A-Fa-f]{4}){3}-[0-9A-Fa-f]{12}")

LONGEST_URI: Final = 4096
"""Characters of a namespace URI that we follow: taking the percent signs out of a longer one costs much memory."""

_Identifier = int | str | uuid.UUID | bytes


def _escaped(uri: str) -> str:
    return uri.replace("%", "%25").replace(";", "%3B")


def _unescaped(uri: str) -> str:
    if len(uri) > LONGEST_URI:
        raise RemoteWireError(JsonCause.VALUE_TEXT, f"a namespace URI of more than {LONGEST_URI} characters")
    return unquote(uri)


def _uri_of(namespaces: tuple[str, ...], index: int) -> str | None:
    return namespaces[index - 1] if 0 < index <= len(namespaces) and namespaces[index - 1] else None


def _index_of(reading: Reading, uri: str) -> int | None:
    """The index of a namespace; None for one that the metadata does not list."""
    if uri in reading.namespaces:
        return reading.namespaces.index(uri) + 1
    if uri == _UA_NAMESPACE:
        return 0
    return None


def encode_node_id(namespaces: tuple[str, ...], value: Any) -> str | None:
    """The text of a NodeId, None for the null NodeId; `namespaces` are those of the metadata, the first has index 1."""
    if not isinstance(value, NodeId):
        raise LocalWireError(f"{value!r:.80} is no NodeId")
    if value == NULL_NODE_ID:
        return None
    return _namespace_text(namespaces, value.namespace) + _identifier_text(value.identifier)


def _namespace_text(namespaces: tuple[str, ...], index: Any) -> str:
    if index.__class__ is not int or not 0 <= index <= 0xFFFF:
        raise LocalWireError(f"{index!r:.80} is no namespace index")
    if not index:
        return ""
    uri = _uri_of(namespaces, index)
    return f"ns={index};" if uri is None else f"nsu={_escaped(uri)};"


def _identifier_text(identifier: Any) -> str:
    if isinstance(identifier, str):
        return f"s={identifier}"
    if isinstance(identifier, uuid.UUID):
        return f"g={identifier}"
    if isinstance(identifier, bytes):
        return f"b={binascii.b2a_base64(identifier, newline=False).decode()}"
    if identifier.__class__ is int and 0 <= identifier <= 0xFFFF_FFFF:
        return f"i={identifier}"
    raise LocalWireError(f"{identifier!r:.80} is no identifier of a NodeId")


def decode_node_id(reading: Reading, value: Any) -> NodeId:
    """A NodeId; one of an unknown namespace is a String NodeId with the whole text (OPC 10000-6 5.4.2.10)."""
    expanded = _decode(reading, value)
    if expanded is None:
        return NULL_NODE_ID
    server, uri, node_id = expanded
    if server:
        raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no NodeId but an ExpandedNodeId")
    if uri is None:
        return node_id
    reading.note(Leniency.NAMESPACE_UNKNOWN)
    return NodeId(0, value if isinstance(value, str) else f"nsu={_escaped(uri)};{_identifier_text(node_id.identifier)}")


def encode_expanded_node_id(namespaces: tuple[str, ...], value: Any) -> str | None:
    """The text of an ExpandedNodeId, None for the null one."""
    if not isinstance(value, ExpandedNodeId):
        raise LocalWireError(f"{value!r:.80} is no ExpandedNodeId")
    node_id, uri, server = value
    if server.__class__ is not int or not 0 <= server <= 0xFFFF_FFFF:
        raise LocalWireError(f"{server!r:.80} is no server index")
    if node_id == NULL_NODE_ID and not uri and not server:
        return None
    namespace = f"nsu={_escaped(uri)};" if uri else _namespace_text(namespaces, node_id.namespace)
    return (f"svr={server};" if server else "") + namespace + _identifier_text(node_id.identifier)


def decode_expanded_node_id(reading: Reading, value: Any) -> ExpandedNodeId:
    """An ExpandedNodeId; one of an unknown namespace keeps its URI (OPC 10000-6 5.4.2.11)."""
    expanded = _decode(reading, value)
    if expanded is None:
        return ExpandedNodeId(NULL_NODE_ID)
    server, uri, node_id = expanded
    return ExpandedNodeId(node_id, uri, server)


def _decode(reading: Reading, value: Any) -> tuple[int, str | None, NodeId] | None:
    """Server index, URI of a namespace that is not listed, and the rest; None for null."""
    if value.__class__ is str:
        return _decode_text(reading, value) if value else None
    if value is None:
        return None
    if value.__class__ is dict:
        reading.note(Leniency.OLD_NODE_ID)
        return _decode_object(reading, value)
    raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no NodeId")


def _decode_text(reading: Reading, text: str) -> tuple[int, str | None, NodeId]:
    server, position, index, unlisted = 0, 0, 0, None
    match = _SERVER.match(text)
    if match is not None:
        server, position = int(match[1]), match.end()
    match = _NAMESPACE.match(text, position)
    if match is not None:
        position = match.end()
        if match[1] is not None:
            index = int(match[1])
        else:
            uri = _unescaped(match[2])
            found = _index_of(reading, uri)
            index, unlisted = (0, uri) if found is None else (found, None)
    if server > 0xFFFF_FFFF or index > 0xFFFF:
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"an index in {shown(text)}")
    return server, unlisted, NodeId(index, _identifier(text, text[position : position + 2], text[position + 2 :]))


def _identifier(text: str, kind: str, rest: str) -> _Identifier:
    try:
        if kind == "i=" and rest.isascii() and rest.isdigit() and len(rest) <= 10 and int(rest) <= 0xFFFF_FFFF:
            return int(rest)
        if kind == "s=":
            return rest
        if kind == "g=" and _GUID.fullmatch(rest):
            return uuid.UUID(rest)
        if kind == "b=":
            return binascii.a2b_base64(rest, strict_mode=True)
    except ValueError:
        pass
    raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(text)} is no NodeId")


def _decode_object(reading: Reading, value: dict[str, Any]) -> tuple[int, str | None, NodeId]:
    """The older form: IdType, Id, Namespace as index or URI, ServerUri as index."""
    namespace: Any = value.get("Namespace") or 0
    server: Any = value.get("ServerUri") or 0
    unlisted: str | None = None
    if namespace.__class__ is str:
        found = _index_of(reading, namespace)
        unlisted, namespace = (namespace, 0) if found is None else (None, found)
    if namespace.__class__ is not int or server.__class__ is not int:
        raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no NodeId")
    if not 0 <= namespace <= 0xFFFF or not 0 <= server <= 0xFFFF_FFFF:
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"an index in {shown(value)}")
    kind, identifier = value.get("IdType") or 0, value.get("Id", 0)
    if kind == 0 and identifier.__class__ is int and 0 <= identifier <= 0xFFFF_FFFF:
        return server, unlisted, NodeId(namespace, identifier)
    if kind in (1, 2, 3) and identifier.__class__ is str:
        prefix = ("s=", "g=", "b=")[cast("int", kind) - 1]
        return server, unlisted, NodeId(namespace, _identifier(identifier, prefix, identifier))
    raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no NodeId")


def encode_qualified_name(namespaces: tuple[str, ...], value: Any) -> str | None:
    """The text of a QualifiedName, None for null.

    A name of namespace 0 that could be taken for one with a namespace gets the index `0:`, so that it can be read back.
    """
    if not isinstance(value, QualifiedName):
        raise LocalWireError(f"{value!r:.80} is no QualifiedName")
    index, name = value
    if index.__class__ is not int or not 0 <= index <= 0xFFFF:
        raise LocalWireError(f"{index!r:.80} is no namespace index")
    if name is None and not index:
        return None
    uri = _uri_of(namespaces, index)
    if uri is not None:
        return f"nsu={_escaped(uri)};{name or ''}"
    text = name or ""
    return f"{index}:{text}" if index or text.startswith("nsu=") or _NAME_INDEX.match(text) else text


def decode_qualified_name(reading: Reading, value: Any) -> QualifiedName:
    """A QualifiedName; one of an unknown namespace is the whole text in namespace 0 (OPC 10000-6 5.4.2.14)."""
    if value.__class__ is str:
        match = _NAMESPACE.match(value) if value.startswith("nsu=") else None
        if match is not None:
            index = _index_of(reading, _unescaped(match[2]))
            if index is None:
                reading.note(Leniency.NAMESPACE_UNKNOWN)
                return QualifiedName(0, value)
            return QualifiedName(index, value[match.end() :])
        match = _NAME_INDEX.match(value)
        if match is not None and int(match[1]) <= 0xFFFF:
            return QualifiedName(int(match[1]), value[match.end() :])
        return QualifiedName(0, value)
    if value is None:
        return NULL_NAME
    if value.__class__ is not dict or not isinstance(value.get("Name"), str | None):
        raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no QualifiedName")
    reading.note(Leniency.OLD_QUALIFIED_NAME)
    name = value.get("Name")
    namespace: Any = value.get("Uri") or 0
    if namespace.__class__ is str:
        found = _index_of(reading, namespace)
        if found is None:
            reading.note(Leniency.NAMESPACE_UNKNOWN)
            return QualifiedName(0, f"nsu={_escaped(namespace)};{name}")
        return QualifiedName(found, name)
    if namespace.__class__ is not int or not 0 <= namespace <= 0xFFFF:
        raise RemoteWireError(JsonCause.VALUE_RANGE, f"the namespace of {shown(value)}")
    return QualifiedName(namespace, name)
