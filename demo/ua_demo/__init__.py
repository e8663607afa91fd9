"""Demonstrations of ua_fleet, and the simulators of the robots and machines in them. Nothing in the product needs it.

pal, talkrobots   the two demonstrations: robots' programs, bridges and the server, started by one command
testbed           the same two, each process in a container
simulators        of a fleet, and of the controllers of a PLC, a robot on TCP and a Universal Robots arm
equations         what the TalkRoBots paper expects of a fleet's messages
commands          `ua-fleet demo`, `simulate` and `testbed`

The modules beside them are what both demonstrations need.
"""
