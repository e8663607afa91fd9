"""Scenarios, faults and decisions: the orchestrator with its journal.

service.py    carries out what the orchestrator says: the journal, time, people
carrying.py   outputs in their order, each written down before it is carried out
requests.py   tasks as requests to robots
values.py     values of robots by the names that conditions use
records.py    runs and decisions as they are shown
library.py    the scenarios' files
restart.py    runs that go on after a restart
"""
