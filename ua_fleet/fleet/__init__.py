"""The state of the fleet, from facts to changes: pure."""

from ua_fleet.fleet.changes import Change, Noticed, SourceAdded, SourceQuarantined, SourceRemoved, ValueChanged
from ua_fleet.fleet.coalesce import Coalescer
from ua_fleet.fleet.commands import Commands, Publication
from ua_fleet.fleet.model import (
    BridgeModel,
    DataSetModel,
    FieldModel,
    FleetModel,
    RobotModel,
    RobotState,
)
from ua_fleet.fleet.state import FleetState

__all__ = [
    "BridgeModel",
    "Change",
    "Coalescer",
    "Commands",
    "DataSetModel",
    "FieldModel",
    "FleetModel",
    "FleetState",
    "Noticed",
    "Publication",
    "RobotModel",
    "RobotState",
    "SourceAdded",
    "SourceQuarantined",
    "SourceRemoved",
    "ValueChanged",
]
