"""Actions (OPC 10000-14 6.2.11.2): requestor and responder as pure state machines."""
