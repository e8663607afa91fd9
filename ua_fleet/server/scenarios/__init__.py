"""Scenarios, faults and decisions on the server: the orchestrator with its journal, and what people see and command.

values.py     values of robots by the names that conditions use (pure)
records.py    runs and decisions as they are shown (pure)
library.py    the scenarios' files
service.py    carries out what the orchestrator says: the journal, time, people
requests.py   tasks as requests to robots
view.py       what happens, as nodes and events in their order
setup.py      all of it put together
nodes.py      Fleet/Scenarios, Fleet/Resilience, Fleet/Faults
alarms.py     fields of a fault as an alarm (pure)
events.py     what happens as events of the Server object (pure)
methods.py    the Methods of these nodes
"""
