"""The state of the fleet, from facts to changes: pure."""
