"""Robots that come and go while the server runs.

roster.py  which robots there are, and how they came: fleet.yaml, RegisterRobot, an announcement on PubSub
offers.py  skills that OPC UA clients do: who offers which, what is asked of whom
"""
