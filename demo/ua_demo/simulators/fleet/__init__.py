"""A virtual fleet on a virtual clock, and what its messages come to.

fleet.py     the fleet and its scenario, as files would say them
robot.py     a robot that takes three seconds for everything
processes.py a bridge and the server: the parts of the real ones, without event loop, disk and nodes
world.py     the clock and the network
run.py       one simulation from its settings to its result
report.py    the result as a table, JSON and CSV, beside the equations
figures.py   the figures of the paper with our values
"""

from ua_demo.simulators.fleet.fleet import Settings
from ua_demo.simulators.fleet.run import Result, simulate

__all__ = ["Result", "Settings", "simulate"]
