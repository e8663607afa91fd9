"""Places of the fleet that robots are sent to, as nodes: `Fleet/Places/<place>`, two Doubles in metres."""

from __future__ import annotations

from collections.abc import Mapping

from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.convert import data_value, raw_id
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.values import ARRAY, BuiltinType, NodeId

__all__ = ["add_places", "places_of"]

_PLACES = "Fleet.Places"
_DOUBLES = int(BuiltinType.DOUBLE | ARRAY)


def places_of(config: FleetConfig) -> dict[str, tuple[float, float]]:
    """The fleet's places by name, and those that criteria measure distances to; of two of a name the first."""
    found = dict(config.fleet.places)
    for criterion in config.resilience.criteria.values():
        if criterion.distance is not None:
            for name, place in criterion.distance.places.items():
                found.setdefault(name, place)
    return found


def add_places(parts: NodeFactory, places: Mapping[str, tuple[float, float]]) -> None:
    """Make the folder and its Variables; the fleet's Object is there."""
    folder = parts.folder(_PLACES, "Places", parts.id("Fleet"))
    for name, (x_m, y_m) in places.items():
        value = data_value(_DOUBLES, (x_m, y_m), 0, parts.now, parts.now)
        key = NodeId(parts.ns, f"{_PLACES}.{name}")
        parts.variable(key, name, folder, raw_id(int(BuiltinType.DOUBLE)), value, own_name=True, is_array=True)
