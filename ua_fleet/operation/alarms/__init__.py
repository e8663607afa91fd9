"""Alarms of limits, of Booleans and of what the server watches itself, as conditions of OPC 10000-9. Pure: time is an
argument. Faults of robots are alarms, too; what follows from them is decided elsewhere (`ua_fleet.orchestrator`).
"""
