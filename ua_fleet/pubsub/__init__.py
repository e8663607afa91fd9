"""Writers and readers of OPC UA PubSub (OPC 10000-14): pure, time is an argument."""
