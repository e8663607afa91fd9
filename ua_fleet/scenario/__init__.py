"""Scenarios: tasks in sequence, in parallel and on conditions, on one robot or on whichever has the capacity. Pure.

    reading = read_scenario(content, file)             # YAML or JSON -> steps, and every mistake with its line
    checked = validate(reading.scenario, fleet, file)  # held against a fleet
    run = Run.create(run_id, checked.scenario, parameters, journal, by=..., now=...)
    run.poll(lookup, now) / granted / accepted / ended / robot_faulted / replaced / answered / ...   -> effects
    run = Run.restore(scenario, facts, journal); run.again(now)                  # after a restart
    reservations.want / release                        # one task at a time for each robot, over all runs

Time is wall clock in seconds, since a run outlives a process. A journal has written a fact down when it returns.
"""

from ua_fleet.scenario.expression import Expression, Lookup, Value, ValueUnknown, parse_expression, split_index
from ua_fleet.scenario.model import Scenario, Task
from ua_fleet.scenario.read import ScenarioReading, read_scenario, scenario_of
from ua_fleet.scenario.reservations import Grant, Reservations
from ua_fleet.scenario.run import ANSWERS, Journal, Run
from ua_fleet.scenario.validate import FleetView, RobotView, Validation, validate

__all__ = [
    "ANSWERS",
    "Expression",
    "FleetView",
    "Grant",
    "Journal",
    "Lookup",
    "Reservations",
    "RobotView",
    "Run",
    "Scenario",
    "ScenarioReading",
    "Task",
    "Validation",
    "Value",
    "ValueUnknown",
    "parse_expression",
    "read_scenario",
    "scenario_of",
    "split_index",
    "validate",
]
