"""Scenarios, faults and decisions: the orchestrator with its journal.

service.py             joins the parts, and carries out what the orchestrator says
robot_news.py          what becomes known of robots, taken in together
run_commands.py        what people do with scenarios and runs
operator_decisions.py  what people do with decisions
fault_reports.py       faults that people and robots report
carrying.py            outputs in their order, each written down before it is carried out
requests.py            tasks as requests to robots
values.py              values of robots by the names that conditions use
records.py             runs and decisions as they are shown
library.py             the scenarios' files
restart.py             runs that go on after a restart
"""
