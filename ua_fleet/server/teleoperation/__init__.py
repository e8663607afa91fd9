"""Robots that people drive by hand, as clients see them (docs/teleoperation.md).

held.py      who holds which robot by this server, and what became of the leases before (pure)
service.py   asks the bridges for leases, sends setpoints, and shows what the bridges say
methods.py   Acquire, Renew, Release and Drive
nodes.py     the Object `Teleoperation` of a robot
"""
