"""Runs, robots, faults and decisions together: pure, for the server and the simulator alike.

    orchestrator = Orchestrator(settings, robots, lookup, journal)
    orchestrator.start / pause / abort / accepted / ended / fault_raised / confirm / poll / ...    -> outputs in order

What has to be carried out is TaskStarted, TaskFollowed and TaskCancelled; all else is for people and nodes.
"""

from ua_fleet.orchestrator.candidates import CriterionSource, DistanceFrom, ResilienceSettings, TasksAhead, ValueOf
from ua_fleet.orchestrator.conditions import FaultConditions, FaultFound, FaultRule
from ua_fleet.orchestrator.faults import Fault, FaultChange, Faults
from ua_fleet.orchestrator.holds import Hold
from ua_fleet.orchestrator.orchestrator import Orchestrator
from ua_fleet.orchestrator.outputs import (
    BridgesFollowed,
    BridgeTold,
    DecisionChanged,
    FaultChanged,
    FaultForecast,
    Halt,
    HaltChanged,
    HoldChanged,
    OperatorAsked,
    Output,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TaskFollowed,
    TaskStarted,
    TaskWaiting,
)

__all__ = [
    "BridgeTold",
    "BridgesFollowed",
    "CriterionSource",
    "DecisionChanged",
    "DistanceFrom",
    "Fault",
    "FaultChange",
    "FaultChanged",
    "FaultConditions",
    "FaultForecast",
    "FaultFound",
    "FaultRule",
    "Faults",
    "Halt",
    "HaltChanged",
    "Hold",
    "HoldChanged",
    "OperatorAsked",
    "Orchestrator",
    "Output",
    "ResilienceSettings",
    "RunBroken",
    "RunChanged",
    "TaskCancelled",
    "TaskFollowed",
    "TaskStarted",
    "TaskWaiting",
    "TasksAhead",
    "ValueOf",
]
