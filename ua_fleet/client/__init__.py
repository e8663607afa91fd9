"""A typed OPC UA client."""
