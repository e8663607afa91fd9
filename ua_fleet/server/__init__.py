"""The OPC UA server, on asyncua."""
