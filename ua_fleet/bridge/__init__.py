"""The kit that every UA bridge stands on.

A bridge package `ua_bridges.<kind>` has `config.py` (its model of `fleet.yaml`, named by an entry point of the group
`ua_fleet.bridges`) and `driver.py` with

    def create_driver(config: FleetConfig, bridge_name: str) -> Driver

which is derived from `Driver`. The rest is here: `run_bridge` runs any driver, `load_driver` finds it. Nothing heavy is
imported.

assembly.py   the parts of a bridge, made and joined
shell.py      what the event loop calls
core.py       decides, without I/O
runner.py     what is opened and closed around them
"""

from ua_fleet.bridge.core import NODE_ONLY, BridgeCore, Rule
from ua_fleet.bridge.driver import (
    Driver,
    DriverEvent,
    DriverStatus,
    Dropped,
    Execution,
    ExecutionEnded,
    ExecutionFact,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
    Inlet,
    SampleRead,
    Skill,
    SkillTarget,
    SourceForgotten,
    SourceFound,
    SourceLost,
    SourceRead,
)
from ua_fleet.bridge.inlet import BoundedInlet
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.bridge.registry import load_driver
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.bridge.status import STATUS_FIELDS, status_topic, status_values

__all__ = [
    "NODE_ONLY",
    "STATUS_FIELDS",
    "BoundedInlet",
    "BridgeCore",
    "Driver",
    "DriverEvent",
    "DriverStatus",
    "Dropped",
    "Execution",
    "ExecutionEnded",
    "ExecutionFact",
    "ExecutionForgotten",
    "ExecutionNotBegun",
    "ExecutionProgressed",
    "ExecutionResumed",
    "ExecutionSuspended",
    "Inlet",
    "Offenders",
    "Rule",
    "SampleRead",
    "Skill",
    "SkillTarget",
    "SourceForgotten",
    "SourceFound",
    "SourceLost",
    "SourceRead",
    "load_driver",
    "run_bridge",
    "status_topic",
    "status_values",
]
