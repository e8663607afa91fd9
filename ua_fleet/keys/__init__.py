"""Where the keys of message security come from (OPC 10000-14 8.3)."""
