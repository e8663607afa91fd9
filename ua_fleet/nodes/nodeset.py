"""The namespaces of the server, and the types of the UaFleet nodeset."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.server.server import Server

from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.standard_model import close_declarations, set_value
from ua_fleet.errors import ServerStartError
from ua_fleet.fleet.model import FIRST_NAMESPACE
from ua_fleet.topics import TYPES_URI

__all__ = ["TYPES_INDEX", "TypeId", "load_types", "nodeset_file"]

TYPES_INDEX: Final = 3


class TypeId(IntEnum):
    """Ids of the nodeset's types that instances are made of; see nodesets/UaFleet.NodeIds.csv."""

    DATA_SET = 1001
    SENSOR = 1002
    CAPABILITY = 1003
    ROBOT = 1004
    TRAFFIC = 1005
    BRIDGE = 1006
    QUARANTINED_SOURCE = 1007
    DISCOVERED = 1008
    FLEET = 1009
    SKILL = 1010
    SKILL_TRANSITION_EVENT = 1011
    SCENARIOS = 1020
    RUN = 1021
    DECISION = 1022
    RESILIENCE = 1023
    FAULTS = 1024
    FAULT_ALARM = 1025
    RUN_EVENT = 1026
    STEP_EVENT = 1027
    DECISION_EVENT = 1028
    OFFERS = 1029
    SKILL_REQUEST_EVENT = 1030
    ROBOT_HOLD_EVENT = 1031
    TELEOPERATION = 1032
    ROBOT_STATE = 3001
    ROBOT_SUMMARY = 3002
    TELEOPERATION_STATE = 3003
    PROVIDES_CAPABILITY = 4001
    ROBOT_SUMMARY_BINARY = 5002
    """The encoding of RobotSummaryDataType."""


def nodeset_file(name: str) -> Path | Traversable:
    """A file of the folder `nodesets`, of the repository or of the installed package."""
    in_repository = Path(__file__).resolve().parents[2] / "nodesets" / name
    return in_repository if in_repository.exists() else files("ua_fleet") / "nodesets" / name


async def load_types(server: Server, fleet_uri: str, fleet_index: int, others: Sequence[str] = ()) -> None:
    """Register the fleet's namespaces, the others behind that of the types, and load the types.

    Raises:
        ServerStartError: a namespace would get another index than topics and nodes are addressed with.
    """
    text = nodeset_file("UaFleet.NodeSet2.xml").read_text(encoding="utf-8")
    uris = [(fleet_uri, fleet_index), (TYPES_URI, TYPES_INDEX)]
    uris += [(uri, FIRST_NAMESPACE + place) for place, uri in enumerate(others)]
    for uri, wanted in uris:
        index = await server.register_namespace(uri)
        if index != wanted:
            raise ServerStartError(
                f"namespace {uri!r} would have the index {index}, not {wanted}; give it another name in "
                f"fleet.namespace_uri or fleet.namespaces"
            )
    await server.import_xml(xmlstring=text)
    _fill_metadata(server.iserver.aspace)
    close_declarations(server.iserver.aspace)


def _fill_metadata(space: AddressSpace) -> None:
    """Say which NodeIds of the types' namespace are static: asyncua loses what the nodeset says."""
    for identifier, value, variant_type in (
        (6015, [0], ua.VariantType.Int32),
        (6016, ["1:65535"], ua.VariantType.String),
        (6017, "", ua.VariantType.String),
    ):
        set_value(space, raw_id(identifier, TYPES_INDEX), value, variant_type)
