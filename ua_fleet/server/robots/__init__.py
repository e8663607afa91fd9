"""Robots that come and go while the server runs.

roster.py     which robots there are, and how they came: fleet.yaml, RegisterRobot, an announcement on PubSub
methods.py    RegisterRobot and UnregisterRobot
changes.py    GeneralModelChangeEvents of what has come and gone
taking.py     all parts of the server that have to know of a robot
"""
