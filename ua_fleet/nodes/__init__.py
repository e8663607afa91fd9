"""The fleet as nodes: address space, projection of values, events, alarms and the Methods that clients call."""
