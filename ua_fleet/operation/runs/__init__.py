"""Runs of scenarios, their records, and what they wait for."""
