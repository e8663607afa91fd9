"""Scenarios, faults and decisions on the server: the orchestrator with its journal, and what people see and command.

values.py     values of robots by the names that conditions use (pure)
records.py    runs and decisions as they are shown (pure)
library.py    the scenarios' files
service.py    carries out what the orchestrator says: requests to robots, the journal, time
nodes.py      Fleet/Scenarios, Fleet/Resilience, Fleet/Faults
alarms.py     fields of a fault as an alarm (pure)
events.py     what happens as events of the Server object (pure)
methods.py    the Methods of these nodes
"""
