"""Scenarios: tasks in sequence, in parallel and on conditions, run by a pure engine."""
