"""A virtual fleet on a virtual clock, and what its messages come to.

fleet.py     the fleet and its scenario, as files would say them
robot.py     a robot that takes three seconds for everything
processes.py a bridge: the parts of the real one, without event loop and disk
server.py    the server: likewise, without nodes
carried.py   what server and bridges have for a run that bridges carry
memory.py    what they have in place of disk and event loop
world.py     the clock and the network
run.py       one simulation from its settings to its result
report.py    the result as a table, JSON and CSV, beside the equations
modes.py     both modes of a run beside each other
figures.py   the figures of the paper with our values
"""

from ua_demo.simulators.fleet.fleet import Settings
from ua_demo.simulators.fleet.run import Result, simulate

__all__ = ["Result", "Settings", "simulate"]
