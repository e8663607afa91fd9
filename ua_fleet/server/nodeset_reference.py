"""The reference of the information model as Markdown: types from the nodeset, Methods from a server that runs.

`python -m ua_fleet.server.nodeset_reference` prints it; with a file it is put between the file's two markers.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import secrets
import sys
import tempfile
from collections import defaultdict
from collections.abc import AsyncIterator, Iterator, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

from asyncua import ua
from asyncua.client.client import Client
from asyncua.common.node import Node
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.object_ids import ObjectIdNames, ObjectIds

from ua_fleet.config.load import load_content
from ua_fleet.config.reference import show_or_put
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.nodes.nodeset import TYPES_INDEX, nodeset_file
from ua_fleet.server.app import run_server
from ua_fleet.transport.memory import MemoryNetwork

__all__ = ["BEGIN", "END", "methods", "reference", "types"]

BEGIN: Final = "<!-- reference: made by `python -m ua_fleet.server.nodeset_reference docs/nodeset.md` -->"
END: Final = "<!-- end of the reference -->"

_XML: Final = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"
_FLEET: Final = b"version: 1\npubsub: {security: none}\nserver: {port: 0, allow_none_security: true}\n"
_PASSWORD: Final = secrets.token_hex(16)
"""Of all users of the server that is made here, which ends with this program."""
_ROLES: Final = (Role.OBSERVER, Role.OPERATOR, Role.ENGINEER)
_SHOWN: Final = {"UAVariable": "Variable", "UAObject": "Object", "UAMethod": "Method"}


def _standard_name(node_id: str) -> str:
    """The name of a node of namespace 0, as `i=58`."""
    return str(ObjectIdNames[int(node_id.removeprefix("i="))])


class _Nodeset:
    """The nodes of the file, with what stands in them."""

    def __init__(self, text: str) -> None:
        # Our own file, so nothing in it expands without end.
        root = ET.fromstring(text)  # noqa: S314
        self.nodes = {node.attrib["NodeId"]: node for node in root if "NodeId" in node.attrib}
        self._aliases = {alias.text: alias.attrib["Alias"] for alias in root.iter(f"{_XML}Alias")}
        self.members: defaultdict[str, list[ET.Element]] = defaultdict(list)
        for node in self.nodes.values():
            self.members[node.attrib.get("ParentNodeId", "")].append(node)

    def name(self, node_id: str) -> str:
        """The name of a node of the file or of the standard."""
        if node_id in self.nodes:
            return _own_name(self.nodes[node_id])
        return self._aliases.get(node_id) or (_standard_name(node_id) if node_id.startswith("i=") else node_id)

    def referenced(self, node: ET.Element, kind: str, *, forward: bool) -> str | None:
        """The target of the first reference of a kind."""
        for reference in node.iter(f"{_XML}Reference"):
            is_forward = reference.attrib.get("IsForward", "true") == "true"
            if reference.attrib["ReferenceType"] == kind and is_forward is forward:
                return reference.text
        return None

    def of_class(self, tag: str) -> Iterator[ET.Element]:
        """The nodes of one class, in the file's order."""
        return (node for node in self.nodes.values() if node.tag == f"{_XML}{tag}")

    def is_event(self, node: ET.Element) -> bool:
        """Whether an ObjectType is one of events."""
        base = self.referenced(node, "HasSubtype", forward=False) or ""
        if base in self.nodes:
            return self.is_event(self.nodes[base])
        return any(word in self.name(base) for word in ("EventType", "AlarmType", "ConditionType"))

    def is_enumeration(self, node: ET.Element) -> bool:
        """Whether a DataType is an enumeration; the others are structures."""
        return self.name(self.referenced(node, "HasSubtype", forward=False) or "") == "Enumeration"


def _own_name(node: ET.Element) -> str:
    return node.attrib["BrowseName"].partition(":")[2] or node.attrib["BrowseName"]


def _text(node: ET.Element) -> str:
    found = node.find(f"{_XML}Description")
    return _prose(found.text or "") if found is not None else ""


def _prose(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("_", "\\_")


def _of_type(nodeset: _Nodeset, node: ET.Element) -> str:
    """One type with its members."""
    base = nodeset.name(nodeset.referenced(node, "HasSubtype", forward=False) or "")
    number = node.attrib["NodeId"].partition(";")[2]
    parts = [f"### {_own_name(node)}", f"`ns={TYPES_INDEX};{number}`, a subtype of {base}. {_text(node)}"]
    rows = list(_rows(nodeset, node.attrib["NodeId"], ""))
    if rows:
        parts.append("\n".join(["| member | class | type | |", "|---|---|---|---|", *rows]))
    return "\n\n".join(parts)


def _rows(nodeset: _Nodeset, owner: str, path: str) -> Iterator[str]:
    for member in nodeset.members[owner]:
        kind = member.tag.removeprefix(_XML)
        rule = nodeset.name(nodeset.referenced(member, "HasModellingRule", forward=True) or "")
        typed = member.attrib.get("DataType") if kind == "UAVariable" else None
        if typed is None and kind == "UAObject":
            typed = nodeset.referenced(member, "HasTypeDefinition", forward=True)
        name = nodeset.name(typed) if typed else ""
        if member.attrib.get("ValueRank", "-1") not in ("-1", "-2"):
            name += "[]"
        text = _text(member) + (" Optional." if "Optional" in rule else "")
        yield f"| `{path}{_own_name(member)}` | {_SHOWN[kind]} | {name} | {text.strip()} |"
        if kind != "UAMethod":
            yield from _rows(nodeset, member.attrib["NodeId"], f"{path}{_own_name(member)}/")


def _enumeration(node: ET.Element) -> str:
    lines = [f"### {_own_name(node)}", "", _text(node), "", "| value | name | |", "|---|---|---|"]
    lines += [
        f"| {field.attrib['Value']} | {field.attrib['Name']} | {_text(field)} |" for field in node.iter(f"{_XML}Field")
    ]
    return "\n".join(lines)


def _structure(nodeset: _Nodeset, node: ET.Element) -> str:
    number = node.attrib["NodeId"].partition(";")[2]
    lines = [f"### {_own_name(node)}", "", f"`ns={TYPES_INDEX};{number}`. {_text(node)}", ""]
    lines += ["| field | type | |", "|---|---|---|"]
    for field in node.iter(f"{_XML}Field"):
        kind = nodeset.name(field.attrib["DataType"]) + ("[]" if field.attrib.get("ValueRank") == "1" else "")
        lines.append(f"| `{field.attrib['Name']}` | {kind} | {_text(field)} |")
    return "\n".join(lines)


def types() -> str:
    """The types of the nodeset, by their kinds."""
    nodeset = _Nodeset(nodeset_file("UaFleet.NodeSet2.xml").read_text(encoding="utf-8"))
    objects = list(nodeset.of_class("UAObjectType"))
    parts = ["## Object types", *[_of_type(nodeset, node) for node in objects if not nodeset.is_event(node)]]
    parts += ["## Event types", *[_of_type(nodeset, node) for node in objects if nodeset.is_event(node)]]
    data_types = list(nodeset.of_class("UADataType"))
    parts += ["## Enumerations", *[_enumeration(node) for node in data_types if nodeset.is_enumeration(node)]]
    structures = [node for node in data_types if not nodeset.is_enumeration(node)]
    parts += ["## Structures", *[_structure(nodeset, node) for node in structures]]
    parts += ["## References", *[_of_type(nodeset, node) for node in nodeset.of_class("UAReferenceType")]]
    return "\n\n".join(parts)


async def _below(node: Node, path: str) -> AsyncIterator[tuple[str, Node]]:
    """All Methods below a node, with their paths."""
    for child in await node.get_children(refs=ObjectIds.HierarchicalReferences):
        name = (await child.read_browse_name()).Name
        if await child.read_node_class() is ua.NodeClass.Method:
            yield f"{path}/{name}", child
        else:
            async for found in _below(child, f"{path}/{name}"):
                yield found


async def _arguments(method: Node, which: str) -> list[Any]:
    for part in await method.get_properties():
        if (await part.read_browse_name()).Name == which:
            return list(await part.read_value())
    return []


async def _table(method: Node) -> str:
    lines = ["| | argument | type | |", "|---|---|---|---|"]
    for which, arrow in (("InputArguments", "in"), ("OutputArguments", "out")):
        for argument in await _arguments(method, which):
            name = _standard_name(f"i={argument.DataType.Identifier}") + ("[]" if argument.ValueRank == 1 else "")
            lines.append(f"| {arrow} | `{argument.Name}` | {name} | {_prose(argument.Description.Text or '')} |")
    return "\n".join(lines)


async def _role_that_may(url: str, methods: Sequence[ua.NodeId]) -> list[str]:
    """The least role by which each Method may be called."""
    least = [""] * len(methods)
    for role in reversed(_ROLES):
        async with _session(url, role) as client:
            for place, method in enumerate(methods):
                answer = await client.get_node(method).read_attribute(AttributeIds.UserExecutable)
                if answer.Value is not None and answer.Value.Value:
                    least[place] = role.name.lower()
    return least


def _session(url: str, role: Role) -> Client:
    client = Client(url)
    client.set_user(role.name.lower())
    client.set_password(_PASSWORD)
    return client


async def _methods_of(url: str) -> str:
    async with _session(url, Role.ENGINEER) as client:
        (fleet,) = [
            child
            for child in await client.nodes.objects.get_children()
            if (await child.read_browse_name()).Name == "Fleet"
        ]
        found = [each async for each in _below(fleet, "Fleet")]
        tables = [await _table(method) for _, method in found]
    roles = await _role_that_may(url, [method.nodeid for _, method in found])
    parts = ["## Methods of the fleet"]
    for (path, _), role, table in zip(found, roles, tables, strict=True):
        parts.append(f"### {path}\n\nRole: {role}\n\n{table}")
    return "\n\n".join(parts)


async def methods() -> str:
    """The Methods of a server without robots, with their arguments and the least role that may call them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = load_content(_FLEET, "fleet.yaml", {})
        state = folder / config.server.state_dir
        state.mkdir()
        users = UserStore(state / USERS_FILE, ScryptCost(2**8, 8, 1))
        for role in _ROLES:
            users.add(role.name.lower(), _PASSWORD, role)
        ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        transport = MemoryNetwork().endpoint()
        serving = asyncio.ensure_future(run_server(config, folder, transport=transport, ready=ready.set_result))
        try:
            waited: list[asyncio.Future[Any]] = [serving, ready]
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            if serving.done():
                serving.result()
            return await _methods_of(await ready)
        finally:
            serving.cancel()
            await asyncio.wait([serving])


def reference() -> str:
    """The whole information model."""
    return f"{types()}\n\n{asyncio.run(methods())}"


if __name__ == "__main__":
    show_or_put(sys.argv[1:], reference(), BEGIN, END)
